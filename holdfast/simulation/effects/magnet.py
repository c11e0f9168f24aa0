"""From force to field: a magnet in silicone above a Hall chip, and its faults.

And from field back to newtons as in the thesis: one linear map for all sensors, fitted to loads.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from functools import cache

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import (
    SENSORS,
    Effect,
    Parameter,
    Plan,
    PlanRequest,
    Reported,
    Rows,
    added,
    as_drawn,
    scaled,
)

UT_PER_T = 1e6
"""Microtesla in a tesla."""
MU0_OVER_4PI = 1e-7
"""Magnetic constant over 4 pi, T m/A."""
REMANENCE_T = 1.35
"""Remanence of N45 neodymium, T."""
MAGNET_M3 = np.pi * 0.75e-3**2 * 0.5e-3
"""Volume of the disc, m^3: 0.75 mm radius, 0.5 mm thick."""
MOMENT_A_M2 = REMANENCE_T * MAGNET_M3 / (4e-7 * np.pi)
"""Moment of an N45 disc, 1.5 x 0.5 mm: remanence times volume over mu0, 0.95 mA m^2."""
NORMAL_N_PER_M = 30e3
"""Stiffness of the silicone dome, Shore 35A, inwards, N/m."""
SHEAR_N_PER_M = 15e3
"""Its stiffness sideways, N/m."""
STIFFENING_N = 30.0
"""Silicone stiffens: displacement = F / (k (1 + |F| / STIFFENING_N))."""

# Pads with strong magnets deep in soft lattice, above magnetometers: eFlesh (Pattabiraman 2025).
# For scenes in uT: their field is never turned into newtons. Numbers from the authors' own probings
# of a pad (set eflesh_calibration).
LEAST_HEIGHT_SHARE = 0.2
"""A magnet is never pressed nearer to its chip than this share of its height."""
PAD_NOISE_UT = np.array([4.3, 4.3, 6.7])
"""Rms of a resting MLX90393, x, y and z: measured on eflesh_slip, median of its channels."""
PAD_STEP_UT = np.array([0.6, 0.6, 0.97])
"""Steps of its readings in that set."""


def dipole_ut(place_m: FloatArray, moment_a_m2: float = MOMENT_A_M2) -> FloatArray:
    """[.., 3] field at the chip, uT, of a dipole along z at place_m [.., 3] above it.

    B = mu0/4pi (3 (m.r) r / r^5 - m / r^3) (Jackson, "Classical electrodynamics", 1998, 5.56).
    """
    z = place_m[..., 2]
    r2 = (place_m * place_m).sum(axis=-1)
    r3 = r2 * np.sqrt(r2)
    # Per mu0 m / 4 pi; the moment points along z, so m.r is m z.
    z_over_r5 = z / (r2 * r3)
    field = 3.0 * z_over_r5[..., None] * place_m
    field[..., 2] -= 1.0 / r3
    return UT_PER_T * MU0_OVER_4PI * moment_a_m2 * field


def place_m(forces_n: FloatArray, height_mm: float | FloatArray) -> FloatArray:
    """[.., 3] position of the magnet under forces [.., 3]: normal pushes down, shear sideways."""
    # Displacement times stiffness, each axis by itself.
    stiffening = 1.0 + np.abs(forces_n) / STIFFENING_N
    yielding = forces_n / stiffening
    place = np.empty_like(yielding)
    place[..., :2] = yielding[..., :2] / SHEAR_N_PER_M
    above = 1e-3 * height_mm - yielding[..., 2] / NORMAL_N_PER_M
    # The magnet never touches the chip: half a millimetre of silicone stays between.
    place[..., 2] = np.maximum(above, 5e-4)
    return place


def dipole(rows: Rows, plan: Plan) -> Rows:
    """Force moves a magnet in silicone; the chip under it reads its dipole field, uT.

    The field at rest is included. Displacement F / (k (1 + |F| / 30 N)) for each axis, k 30 N/mm
    inwards and 15 N/mm sideways (a Shore-35A dome); field: dipole_ut.
    """
    return replace(
        rows, values=dipole_ut(place_m(rows.values, plan["height_mm"][..., 0]))
    )


def leak_plan(request: PlanRequest) -> Plan:
    """Shares of the neighbours' field and of the other axes."""
    # A field falls as r^-3, the spacing being much larger than the height.
    ratio = (request["height_mm"] / request["spacing_mm"]) ** 3
    return {
        "near": np.full((1, 1, 1), ratio),
        "axes": np.full((1, 1, 1), request["axes"]),
    }


def cross_talk(rows: Rows, plan: Plan) -> Rows:
    """Axes leak into each other, and neighbours' magnets add (height / spacing)^3 of their field.

    A dipole's field falls as r^-3; neighbours are the sensors before and after. uT.
    """
    values = rows.values
    near = np.zeros_like(values)
    # A sensor at either end of the row has one neighbour only.
    near[:, 1:] += values[:, :-1]
    near[:, :-1] += values[:, 1:]
    other_axes = values.sum(axis=2, keepdims=True) - values
    leak = plan["axes"] * other_axes
    return replace(rows, values=values + plan["near"] * near + leak)


def turn_plan(request: PlanRequest) -> Plan:
    """Each sensor's gain, 1 + gain_sd n, and its tilt, tilt_sd_deg n about x and y.

    n is standard normal. Both are drawn for each recording, so a model cannot learn the
    calibration.
    """
    gain = 1.0 + request["gain_sd"] * request.rng.normal(size=(request.sensors, 1))
    angle = np.radians(request["tilt_sd_deg"]) * request.rng.normal(
        size=(2, request.sensors)
    )
    cx, cy = np.cos(angle)
    sx, sy = np.sin(angle)
    zeros = np.zeros(request.sensors)
    ones = np.ones(request.sensors)

    # Rotation matrices of all sensors, [3, 3, S] each; the one about x acts first.
    about_x = np.array([[ones, zeros, zeros], [zeros, cx, -sx], [zeros, sx, cx]])
    about_y = np.array([[cy, zeros, sy], [zeros, ones, zeros], [-sy, zeros, cy]])

    return {
        "gain": gain[None],
        "turn": np.einsum("ijs,jks->sik", about_y, about_x)[None],
    }


def gain_tilt(rows: Rows, plan: Plan) -> Rows:
    """Values become gain * R v, R the rotation of the sensor."""
    turned = np.einsum("rsij,rsj->rsi", plan["turn"], rows.values)
    return replace(rows, values=plan["gain"] * turned)


def reversed_plan(request: PlanRequest) -> Plan:
    """-1 where the magnet of a sensor (1 .. S) is upside down (thesis), whose field flips.

    Those of the list are, and of the others each by chance, with probability `share`.
    """
    sign = np.ones((1, request.sensors, 1))
    if "share" in request.drawn:
        sign[0, request.rng.uniform(size=request.sensors) < request["share"]] = -1.0
    sign[:, request.places] = -1.0
    return {"factor": sign}


def warm_degc(request: PlanRequest) -> FloatArray:
    """[T] by how much the sensors are warmer than at the start: a body of first order."""
    approach = 1.0 - np.exp(-request.t_s / request["time_s"])
    warmer: FloatArray = request["warming_degc"] * approach
    return warmer


def offset_plan(request: PlanRequest) -> Plan:
    """What each axis of each chip reads more for each degree, times the warming, uT."""
    size = (1, request.sensors, 3)
    per_degc = request["offset_ut_per_degc"] * request.rng.normal(size=size)
    return {"added": per_degc * warm_degc(request)[:, None, None]}


def warming_plan(request: PlanRequest) -> Plan:
    """The magnets warm by w (1 - exp(-t / tau)) degC and lose 0.12 % of their field per degree.

    That is for neodymium. With compensated = 1 the chip's own temperature coefficient corrects for
    it, and a tenth remains.
    """
    warm = warm_degc(request)
    remaining = 0.1 if request["compensated"] else 1.0
    share = 0.0012 * remaining
    return {"factor": (1.0 - share * warm)[:, None, None]}


def pad_plan(request: PlanRequest) -> Plan:
    """The magnet's moment from its field at rest, and how far a newton moves it."""
    height_m = 1e-3 * request["height_mm"]
    # On its axis a dipole has mu0/4pi 2 m / h^3.
    rest_t = request["rest_ut"] / UT_PER_T
    moment_a_m2 = rest_t * height_m**3 / (2.0 * MU0_OVER_4PI)
    per_n = [
        request["shear_n_per_mm"],
        request["shear_n_per_mm"],
        -request["normal_n_per_mm"],
    ]
    return {
        "height_m": np.full((1, 1), height_m),
        "moment_a_m2": np.full((1, 1, 1), moment_a_m2),
        "m_per_n": (1e-3 / np.array(per_n))[None, None],
    }


def pad_magnet(rows: Rows, plan: Plan) -> Rows:
    """Field of a magnet that the load on its part of the pad moves, uT; its field at rest included.

    The place is force over stiffness, linear: normal force pushes it towards the chip, shear moves
    it sideways. Field: dipole_ut. For small loads z changes by 3 rest / (height k) a newton
    of normal force, x by 1.5 rest / (height k) a newton of shear.
    """
    place_m = rows.values * plan["m_per_n"]
    height_m = plan["height_m"]
    lowest_m = LEAST_HEIGHT_SHARE * height_m
    place_m[..., 2] = np.maximum(height_m + place_m[..., 2], lowest_m)
    return replace(rows, values=dipole_ut(place_m, 1.0) * plan["moment_a_m2"])


def magnetometer(rows: Rows, plan: Plan) -> Rows:
    """Adds the noise of a MLX90393 and rounds to its steps, uT."""
    noisy = rows.values + plan["noise_ut"]
    return replace(rows, values=np.rint(noisy / PAD_STEP_UT) * PAD_STEP_UT)


WARMING = Parameter({"uniform": [0, 10]}, "degC", -50, 80, "final warming")
WARMING_TIME = Parameter(300.0, "s", 1, 1e5, "time constant")
HEIGHT = Parameter(2.0, "mm", 1.5, 20, "from chip to magnet, unloaded")
EFFECTS = {
    "dipole": Effect(
        dipole,
        {"height_mm": HEIGHT},
        as_drawn,
        gives_unit="uT",
    ),
    "cross_talk": Effect(
        cross_talk,
        {
            "height_mm": HEIGHT,
            "spacing_mm": Parameter(
                20.0, "mm", 5, 200, "between neighbouring fingertips"
            ),
            "axes": Parameter(0.01, "", 0, 0.3, "share of the other axes"),
        },
        leak_plan,
        needs=("dipole",),
        neutral={"height_mm": 0, "axes": 0},
    ),
    "gain_tilt": Effect(
        gain_tilt,
        {
            "gain_sd": Parameter(0.05, "", 0, 0.5, "spread of the gains"),
            "tilt_sd_deg": Parameter(3.0, "deg", 0, 45, "spread of the angles"),
        },
        turn_plan,
        neutral={"gain_sd": 0, "tilt_sd_deg": 0},
    ),
    "magnet_reversed": Effect(
        scaled,
        {
            "sensors": SENSORS,
            "share": Parameter(None, "", 0, 1, "chance of every other magnet"),
        },
        reversed_plan,
        needs=("dipole",),
        example={"sensors": [2, 5]},
        neutral={"sensors": []},
    ),
    "thermal_drift": Effect(
        scaled,
        {
            "warming_degc": WARMING,
            "time_s": WARMING_TIME,
            "compensated": Parameter(1.0, "", 0, 1, "1: the chip compensates"),
        },
        warming_plan,
        needs=("dipole",),
        example={"warming_degc": 10},
        neutral={"warming_degc": 0, "compensated": 0},
    ),
    "temperature": Effect(
        added,
        {
            "warming_degc": WARMING,
            "time_s": WARMING_TIME,
            # Typical of a TMAG5273 (data sheet SLYS045).
            "offset_ut_per_degc": Parameter(
                3.0, "uT/degC", 0, 100, "spread of the axes' offset drifts"
            ),
        },
        offset_plan,
        needs=("dipole",),
        example={"warming_degc": 10},
        neutral={"warming_degc": 0},
    ),
    "pad_magnet": Effect(
        pad_magnet,
        {
            # Magnetometers of eflesh_slip read 4.4 to 11.5 mT at rest.
            "rest_ut": Parameter(
                {"uniform": [4400, 11500]},
                "uT",
                10,
                1e5,
                "field at rest, on the magnet's axis",
            ),
            "height_mm": Parameter(
                {"uniform": [8, 16]}, "mm", 1, 50, "from chip to magnet, unloaded"
            ),
            # The probed pads change by 25 to 120 uT a newton of normal force on the whole pad, and
            # by 11 to 74 uT a newton of shear. A fifth of the load rests on each of five magnets.
            "normal_n_per_mm": Parameter(
                {"log_uniform": [2, 10]},
                "N/mm",
                0.05,
                1000,
                "force that moves a magnet inwards",
            ),
            "shear_n_per_mm": Parameter(
                {"log_uniform": [1.5, 8]},
                "N/mm",
                0.05,
                1000,
                "force that moves it sideways",
            ),
        },
        pad_plan,
        gives_unit="uT",
        only_unit="uT",
    ),
    "magnetometer": Effect(
        magnetometer,
        {"noise": Parameter(1.0, "", 0, 100, "factor of the chip's noise")},
        # White noise of each axis, times a factor.
        lambda one: {"noise_ut": one["noise"] * PAD_NOISE_UT * one.noise()},
        needs=("pad_magnet",),
        only_unit="uT",
    ),
}
SHEAR_SHARE = 0.5
"""Largest shear of the calibration's loads over their normal force."""


def loads_n() -> FloatArray:
    """[M, 3] the thesis' loads: 0 .. 14 N normal, and shear to every side at 5 and 14 N normal."""
    loads = [(0.0, 0.0, float(force)) for force in range(15)]

    # Shear grows in quarters of its largest share, in eight directions.
    for force in (5.0, 14.0):
        for share in (0.25, 0.5, 0.75, 1.0):
            for angle in np.radians(np.arange(0, 360, 45)):
                shear = share * SHEAR_SHARE * force
                loads.append((shear * np.cos(angle), shear * np.sin(angle), force))
    return np.array(loads)


@cache
def linear_map() -> tuple[FloatArray, FloatArray]:
    """(matrix [3, 3] N/uT, rest field [3] uT): force = matrix (field - rest), least squares."""
    forces = loads_n()
    # The unloaded field is no load: it is taken off before the fit.
    rest = dipole_ut(place_m(np.zeros((1, 3)), HEIGHT.default))[0]
    fields = dipole_ut(place_m(forces, HEIGHT.default)) - rest
    solution = np.linalg.lstsq(fields, forces, rcond=None)[0]
    return solution.T, rest


def calibrate(rows: Reported) -> Reported:
    """Rows in uT as newtons, its bias not removed.

    The magnet's own field is 23 N, that of a magnet upside down -23 N.
    """
    # The resting field stays in, as in the files of the thesis: readers recognise a reversed magnet
    # by the sign of that offset.
    matrix, _ = linear_map()
    newton = np.einsum("ij,tsj->tsi", matrix, rows.values)
    return replace(rows, values=newton, unit="N")


def shear_gain() -> float:
    """Read over true ratio of shear and normal force, at a light touch of 1 N with 0.5 N of shear.

    The map is fitted to loads up to 14 N, and silicone stiffens: a light touch reads too little
    along the skin.
    """
    matrix, rest = linear_map()
    touch_n = np.array([[0.5, 0.0, 1.0]])
    field = dipole_ut(place_m(touch_n, HEIGHT.default)) - rest
    shear_n, _, normal_n = (field @ matrix.T)[0]
    return float(shear_n / (0.5 * normal_n))


def shear_gain_in(effects: Container[str]) -> float:
    """The same of the sensors of a scene with these effects."""
    # A calibrated magnet reads too little shear; an ideal sensor does not.
    return shear_gain() if "dipole" in effects else 1.0
