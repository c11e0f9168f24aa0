"""From field back to newtons as in the thesis: one linear map for all sensors, fitted to loads."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.simulation.effect import Signal
from holdfast.simulation.sensor.magnet import HEIGHT, dipole_ut, place_m

SHEAR_SHARE = 0.5
"""Largest shear of the calibration's loads over their normal force."""


def loads_n() -> FloatArray:
    """[M, 3] the thesis' loads: 0 .. 14 N normal, and shear to every side at 5 and 14 N normal."""
    normal = np.stack([np.zeros(15), np.zeros(15), np.arange(15.0)], axis=1)
    angles = np.radians(np.arange(0, 360, 45))
    shear = [
        [share * SHEAR_SHARE * force * np.cos(a), share * SHEAR_SHARE * force * np.sin(a), force]
        for force in (5.0, 14.0)
        for share in (0.25, 0.5, 0.75, 1.0)
        for a in angles
    ]
    return np.concatenate([normal, np.array(shear)])


@cache
def linear_map() -> tuple[FloatArray, FloatArray]:
    """(matrix [3, 3] N/uT, rest field [3] uT): force = matrix (field - rest), least squares."""
    forces = loads_n()
    rest = dipole_ut(place_m(np.zeros((1, 3)), HEIGHT.default))[0]
    fields = dipole_ut(place_m(forces, HEIGHT.default)) - rest
    solution = np.linalg.lstsq(fields, forces, rcond=None)[0]
    return solution.T, rest


def calibrate(signal: Signal) -> Signal:
    """A signal in uT as newtons, its bias not removed.

    The magnet's own field is 23 N, that of a magnet upside down -23 N.
    """
    matrix, _ = linear_map()
    newton = np.einsum("ij,tsj->tsi", matrix, signal.values)
    return replace(signal, values=newton, unit="N")


def residual_n() -> tuple[float, float]:
    """RMS error of the map over its loads: (normal, shear), N; hardware: 0.27, 0.12."""
    matrix, rest = linear_map()
    forces = loads_n()
    error = (dipole_ut(place_m(forces, HEIGHT.default)) - rest) @ matrix.T - forces
    return float(np.sqrt((error[:, 2] ** 2).mean())), float(np.sqrt((error[:, :2] ** 2).mean()))


def shear_gain() -> float:
    """True over read ratio of shear and normal force, at a light touch of 1 N with 0.5 N of shear.

    The map is fitted to loads up to 14 N, and silicone stiffens: a light touch reads too little
    along the skin.
    """
    matrix, rest = linear_map()
    force = np.array([[0.5, 0.0, 1.0]])
    read = (dipole_ut(place_m(force, HEIGHT.default)) - rest) @ matrix.T
    return float(0.5 * read[0, 2] / read[0, 0])
