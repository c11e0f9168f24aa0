"""From field to force: one matrix [3, 3] in N/uT for each sensor.

Where several sensors lie under one load (a pad, or six fingertips pressed in turn), each sensor
gives its share, and the load is the sum of the shares. calibration_fit.py fits the matrices,
calibration_file.py stores them, bias.py measures what the unloaded hand reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.edge_runtime.contract import NORMAL_AXIS, BoolArray, FloatArray
from holdfast.edge_runtime.errors import (
    ChannelError,
)


@dataclass(frozen=True)
class CalibrationOrigin:
    """Where a calibration comes from.

    source: of the loads. date: as the caller gave it. load_unit: the unit in which the loads were
    read. n: rows fitted. residual_n: [S, 3] RMSE over the fitted rows, nan where an axis was never
    loaded; sensors under one load share the residual of that load.
    """

    source: str
    date: str
    load_unit: str
    n: int
    residual_n: FloatArray


@dataclass(frozen=True)
class Calibration:
    """matrix [S, 3, 3] N/uT; rest_ut [S, 3] the resting field, None where fields come tared.

    reversed [S]: whose magnet is upside down. A row of zeros in a matrix is an axis that was never
    loaded. The matrix is that of an upright magnet. A reversed magnet has the field of the other
    sign on all three axes, and `apply` turns it.
    """

    matrix: FloatArray
    rest_ut: FloatArray | None
    reversed: BoolArray
    meta: CalibrationOrigin

    def apply(self, field_ut: FloatArray) -> FloatArray:
        """[.., S, 3] uT -> [.., S, 3] N; a nan makes its whole sensor nan. Raises ChannelError."""
        if field_ut.shape[-2:] != self.matrix.shape[:2]:
            raise ChannelError(
                f"a field of shape {list(field_ut.shape)} for {len(self.matrix)} sensors",
                cause="the calibration is of another hand",
                next_step=f"use fields [.., {len(self.matrix)}, 3], or calibrate this hand",
            )
        moved = field_ut if self.rest_ut is None else field_ut - self.rest_ut
        force: FloatArray = np.einsum("sij,...sj->...si", self.matrix, turn(self.reversed) * moved)
        return force


def turn(reversed_: BoolArray) -> FloatArray:
    """[S, 1] the sign that turns a reversed magnet's field."""
    return np.where(reversed_, -1.0, 1.0)[:, None]


def rmse_normal(error_n: FloatArray) -> float:
    """Root mean square of [.., 3] errors along the normal."""
    return float(np.sqrt(np.mean(error_n[..., NORMAL_AXIS] ** 2)))


def rmse_shear(error_n: FloatArray) -> float:
    """Root mean square of [.., 3] errors over the loaded shear axes (not nan); nan without any."""
    shear = np.delete(error_n, NORMAL_AXIS, axis=-1)
    known = shear[np.isfinite(shear)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
