"""Fields and loads of one piece of hardware, in probings; and the errors of a model on them.

A probing is a series of presses from unloaded to unloaded. Every split leaves one probing out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.drivers.calibration import rmse_normal, rmse_shear
from holdfast.edge_runtime.contract import BoolArray, FloatArray

PUBLISHED_N = {"normal": 0.27, "shear": 0.12}
"""RMSE of eFlesh's network; its test rows are the last fifth of the probing it was trained on."""


@dataclass(frozen=True)
class Probing:
    """field_ut [M, S, 3] less its rest; load [M, 3] in the study's unit, nan if not measured."""

    name: str
    field_ut: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class Study:
    """Probings of one piece of hardware.

    load_n: newtons in one unit of the load. rest_ut: [S, 3] or None. reversed_: [S] magnets that
    are upside down, or None where the polarity is unknown. evidence: lines that explain the unit.
    """

    name: str
    probings: tuple[Probing, ...]
    load_unit: str
    load_n: float
    rest_ut: FloatArray | None
    reversed_: BoolArray | None
    evidence: tuple[str, ...]

    @property
    def field_ut(self) -> FloatArray:
        """[M, S, 3] of all probings."""
        return np.concatenate([one.field_ut for one in self.probings])

    @property
    def force_n(self) -> FloatArray:
        """[M, 3] of all probings."""
        return self.load_n * np.concatenate([one.load for one in self.probings])

    @property
    def blocks(self) -> FloatArray:
        """[M] number of the probing of each row."""
        return np.repeat(
            np.arange(len(self.probings), dtype=np.float64),
            [len(one.load) for one in self.probings],
        )


@dataclass(frozen=True)
class AxisError:
    """Root mean square error over the probings left out, and on each, N."""

    rmse_n: float
    each_probing_n: list[float]


@dataclass(frozen=True)
class Judged:
    """A model's errors: held_out_n [G, 3] RMSE on each probing left out; nan: axis not loaded."""

    name: str
    held_out_n: FloatArray

    def errors(self) -> dict[str, AxisError]:
        """For normal and shear, where every probing was loaded on that axis."""
        errors = {}
        for axis, of in (("normal", rmse_normal), ("shear", rmse_shear)):
            each = [of(row) for row in self.held_out_n]
            if np.isfinite(each).all():
                errors[axis] = AxisError(float(np.sqrt(np.mean(np.square(each)))), each)
        return errors
