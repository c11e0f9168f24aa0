"""Pads with strong magnets deep in soft lattice, above magnetometers: eFlesh (Pattabiraman 2025).

For scenes in uT: the field is never turned into newtons. Numbers from the authors' own probings of
a pad (set eflesh_calibration): see the parameters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.simulation.effect import Effect, Parameter, Rows
from holdfast.simulation.magnet import MU0_OVER_4PI, UT_PER_T, dipole_ut
from holdfast.simulation.rows import Plan, PlanRequest, RowEffect

LEAST_HEIGHT_SHARE = 0.2
"""A magnet is never pressed nearer to its chip than this share of its height."""
NOISE_UT = np.array([4.3, 4.3, 6.7])
"""Rms of a resting MLX90393, x, y and z: measured on eflesh_slip, median of its channels."""
STEP_UT = np.array([0.6, 0.6, 0.97])
"""Steps of its readings in that set."""


def magnet_plan(request: PlanRequest) -> Plan:
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
    it sideways. Field: magnet.dipole_ut. For small loads z changes by 3 rest / (height k) a newton
    of normal force, x by 1.5 rest / (height k) a newton of shear.
    """
    place_m = rows.values * plan["m_per_n"]
    height_m = plan["height_m"]
    lowest_m = LEAST_HEIGHT_SHARE * height_m
    place_m[..., 2] = np.maximum(height_m + place_m[..., 2], lowest_m)
    return replace(rows, values=dipole_ut(place_m, 1.0) * plan["moment_a_m2"])


def noise_plan(request: PlanRequest) -> Plan:
    """White noise of each axis, times a factor."""
    return {"noise_ut": request["noise"] * NOISE_UT * request.noise()}


def magnetometer(rows: Rows, plan: Plan) -> Rows:
    """Adds the noise of a MLX90393 and rounds to its steps, uT."""
    noisy = rows.values + plan["noise_ut"]
    return replace(rows, values=np.rint(noisy / STEP_UT) * STEP_UT)


MAGNET = {
    # Magnetometers of eflesh_slip read 4.4 to 11.5 mT at rest.
    "rest_ut": Parameter(
        {"uniform": [4400, 11500]}, "uT", 10, 1e5, "field at rest, on the magnet's axis"
    ),
    "height_mm": Parameter(
        {"uniform": [8, 16]}, "mm", 1, 50, "from chip to magnet, unloaded"
    ),
    # The probed pads change by 25 to 120 uT a newton of normal force on the whole pad, and by 11 to
    # 74 uT a newton of shear. A fifth of the load rests on each of five magnets.
    "normal_n_per_mm": Parameter(
        {"log_uniform": [2, 10]},
        "N/mm",
        0.05,
        1000,
        "force that moves a magnet inwards",
    ),
    "shear_n_per_mm": Parameter(
        {"log_uniform": [1.5, 8]}, "N/mm", 0.05, 1000, "force that moves it sideways"
    ),
}
"""Parameters of the effect `pad_magnet`."""
NOISE = {"noise": Parameter(1.0, "", 0, 100, "of the chip's noise")}
"""Parameter of the effect `magnetometer`."""
EFFECTS = {
    "pad_magnet": Effect(
        "pad_magnet",
        "sensor",
        RowEffect(magnet_plan, pad_magnet),
        MAGNET,
        gives_unit="uT",
        only_unit="uT",
    ),
    "magnetometer": Effect(
        "magnetometer",
        "sensor",
        RowEffect(noise_plan, magnetometer),
        NOISE,
        needs=("pad_magnet",),
        only_unit="uT",
    ),
}
