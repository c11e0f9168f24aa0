"""From force to field: a magnet in silicone above a Hall chip, and its faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge_runtime.contract import FloatArray
from simulation.effect import Drawn, Effect, Signal
from simulation.values import Parameter

UT_PER_T = 1e6
MU0_OVER_4PI = 1e-7
REMANENCE_T = 1.35
MAGNET_M3 = np.pi * 0.75e-3**2 * 0.5e-3
MOMENT_A_M2 = REMANENCE_T * MAGNET_M3 / (4e-7 * np.pi)
"""Of an N45 disc, 1.5 x 0.5 mm: 0.95 mA m^2."""
NORMAL_N_PER_M, SHEAR_N_PER_M = 30e3, 15e3
STIFFENING_N = 30.0
"""Silicone stiffens: displacement = F / (k (1 + |F| / STIFFENING_N))."""
EARTH_UT = np.array([20.0, 0.0, 43.0])


def dipole_ut(place_m: FloatArray, moment_a_m2: float = MOMENT_A_M2) -> FloatArray:
    """[.., 3] field at the chip, uT, of a dipole along z at place_m [.., 3] above it.

    B = mu0/4pi (3 (m.r) r / r^5 - m / r^3) (Jackson, "Classical electrodynamics", 1998, 5.56).
    """
    z = place_m[..., 2]
    r2 = (place_m * place_m).sum(axis=-1)
    r3 = r2 * np.sqrt(r2)
    field = 3.0 * (z / (r2 * r3))[..., None] * place_m
    field[..., 2] -= 1.0 / r3
    scaled: FloatArray = UT_PER_T * MU0_OVER_4PI * moment_a_m2 * field
    return scaled


def place_m(forces_n: FloatArray, height_mm: float) -> FloatArray:
    """[.., 3] position of the magnet under forces [.., 3]: normal pushes down, shear sideways."""
    yielding = forces_n / (1.0 + np.abs(forces_n) / STIFFENING_N)
    return np.stack(
        [
            yielding[..., 0] / SHEAR_N_PER_M,
            yielding[..., 1] / SHEAR_N_PER_M,
            np.maximum(1e-3 * height_mm - yielding[..., 2] / NORMAL_N_PER_M, 5e-4),
        ],
        axis=-1,
    )


def dipole(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """Force moves a magnet in silicone; the chip under it reads its dipole field, uT.

    The field at rest is included. Displacement F / (k (1 + |F| / 30 N)) for each axis, k 30 N/mm
    inwards and 15 N/mm sideways (a Shore-35A dome); field: dipole_ut.
    """
    return replace(signal, values=dipole_ut(place_m(signal.values, drawn["height_mm"])), unit="uT")


def cross_talk(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """Axes leak into each other, and neighbours' magnets add (height / spacing)^3 of their field.

    A dipole's field falls as r^-3; neighbours are the sensors before and after. uT.
    """
    ratio = (drawn["height_mm"] / drawn["spacing_mm"]) ** 3
    own = signal.values
    near = np.zeros_like(own)
    near[:, 1:] += own[:, :-1]
    near[:, :-1] += own[:, 1:]
    leak = drawn["axes"] * (own.sum(axis=2, keepdims=True) - own)
    return replace(signal, values=own + ratio * near + leak)


def gain_tilt(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """Each sensor has its own gain, 1 + gain_sd n, and its own tilt, tilt_sd_deg n about x and y.

    n is standard normal. Values become gain * R v, R the rotation. Both are drawn for each
    recording, so a model cannot learn the calibration.
    """
    sensors = signal.values.shape[1]
    gain = 1.0 + drawn["gain_sd"] * rng.normal(size=(sensors, 1))
    angle = np.radians(drawn["tilt_sd_deg"]) * rng.normal(size=(2, sensors))
    (cx, cy), (sx, sy) = np.cos(angle), np.sin(angle)
    zero, one = np.zeros(sensors), np.ones(sensors)
    about_x = np.array([[one, zero, zero], [zero, cx, -sx], [zero, sx, cx]])
    about_y = np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]])
    turn = np.einsum("ijs,jks->sik", about_y, about_x)
    return replace(signal, values=gain * np.einsum("sij,tsj->tsi", turn, signal.values))


def magnet_reversed(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """The magnets of these sensors (1 .. 6) are upside down (thesis): their field flips."""
    return replace(signal, values=_at(signal.values, drawn["sensors"], -1.0))


def magnet_lost(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """From at_s on the magnets of these sensors are lost; the earth's field remains, 48 uT."""
    values = signal.values.copy()
    gone = signal.t_s >= drawn["at_s"]
    for index in _indices(drawn["sensors"]):
        values[gone, index] = EARTH_UT
    return replace(signal, values=values)


def thermal_drift(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """The magnets warm by w (1 - exp(-t / tau)) degC and lose 0.12 % of their field per degree.

    That is for neodymium. With compensated = 1 the chip's own temperature coefficient corrects for
    it, and a tenth remains.
    """
    warm = drawn["warming_degc"] * (1.0 - np.exp(-signal.t_s / drawn["time_s"]))
    share = 0.0012 * (0.1 if drawn["compensated"] else 1.0)
    return replace(signal, values=signal.values * (1.0 - share * warm)[:, None, None])


def _at(values: FloatArray, sensors: Sequence[float], factor: float) -> FloatArray:
    changed = values.copy()
    changed[:, _indices(sensors)] *= factor
    return changed


def _indices(sensors: Sequence[float]) -> list[int]:
    return [int(number) - 1 for number in sensors]


HEIGHT = Parameter(2.0, "mm", 1.5, 20, "from chip to magnet, unloaded")
SENSORS = Parameter([], "", 1, 6, "which sensors", many=True)
MAGNET = (
    Effect("dipole", "sensor", dipole, {"height_mm": HEIGHT}, gives_unit="uT"),
    Effect(
        "cross_talk",
        "sensor",
        cross_talk,
        {
            "height_mm": HEIGHT,
            "spacing_mm": Parameter(20.0, "mm", 5, 200, "between neighbouring fingertips"),
            "axes": Parameter(0.01, "", 0, 0.3, "share of the other axes"),
        },
        needs=("dipole",),
    ),
    Effect(
        "gain_tilt",
        "sensor",
        gain_tilt,
        {
            "gain_sd": Parameter(0.05, "", 0, 0.5, "spread of the gains"),
            "tilt_sd_deg": Parameter(3.0, "deg", 0, 45, "spread of the angles"),
        },
    ),
    Effect("magnet_reversed", "sensor", magnet_reversed, {"sensors": SENSORS}, needs=("dipole",)),
    Effect(
        "magnet_lost",
        "sensor",
        magnet_lost,
        {"sensors": SENSORS, "at_s": Parameter(5.0, "s", 0, 1e6, "time of the loss")},
        needs=("dipole",),
    ),
    Effect(
        "thermal_drift",
        "sensor",
        thermal_drift,
        {
            "warming_degc": Parameter({"uniform": [0, 10]}, "degC", -50, 80, "final warming"),
            "time_s": Parameter(300.0, "s", 1, 1e5, "time constant"),
            "compensated": Parameter(1.0, "", 0, 1, "1: the chip compensates"),
        },
        needs=("dipole",),
    ),
)
