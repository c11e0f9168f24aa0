"""The five cases: which samples around a critical point, which features, and which classes.

S sensors, so 3 S channels; a window is 7 samples. In the thesis S is 20: 7 x 60, 7 x 40
and 7 x 3.

1   -3 .. +3 samples about the point, as they are, [7, 3 S]: detection, the point is in the window
2   the same as friction ratios x/z and y/z of every sensor, [7, 2 S]. The thesis divides by z as
    it is. Here the divisor is at least a tenth of what the most loaded sensor bears (95th
    percentile of the training windows). The case "2, bare" divides by z as it is, 0 where z is 0
3   length and direction of the shear's first principal component, and the normal's, [7, 3]. The
    components are over the sensors, of x, of y and of z (chapter 3.1.1), from the training windows
    alone and without scaling: length sqrt(px^2 + py^2) and direction atan2(py, px), rad, and pz.
    The thesis does not say over what it scaled
4   as 1, but -7 .. -1: prediction, the window ends one sample before the point
5   as 4, with four classes: grasp, not slipping under disturbances, safe slip, slipping

Cases 1 to 4 separate safe (the first three) from risky (slipping). A feature function learns from
the training windows alone, and turns other windows into features.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray
from studies.thesis_preliminary.points import KINDS, SLIPPING

LEAST_SHARE = 0.1
LOADED_QUANTILE = 0.95
Features = Callable[[FloatArray, FloatArray], FloatArray]
"""(training windows [N, 7, 3 S], windows [M, 7, 3 S]) -> features [M, 7, K]."""


def raw(training: FloatArray, windows: FloatArray) -> FloatArray:
    """[M, 7, 3 S] the samples as they are, in the set's unit."""
    return windows


def friction_ratios(training: FloatArray, windows: FloatArray) -> FloatArray:
    """[M, 7, 2 S] x/z and y/z of every sensor, z at least a tenth of the most loaded sensor's."""
    loads = np.quantile(np.abs(training[..., 2::3]), LOADED_QUANTILE, axis=(0, 1))
    least = max(LEAST_SHARE * loads.max(), np.finfo(float).tiny)
    normal = np.maximum(windows[..., 2::3], least)
    both = [windows[..., 0::3] / normal, windows[..., 1::3] / normal]
    return np.stack(both, axis=-1).reshape(*windows.shape[:2], -1)


def first_components(training: FloatArray, windows: FloatArray) -> FloatArray:
    """[M, 7, 3] length and direction (rad) of the shear's first component over the sensors, and the
    normal's."""
    x, y, z = (
        windows[..., axis::3] @ _direction(training[..., axis::3]) for axis in range(3)
    )
    return np.stack([np.hypot(x, y), np.arctan2(y, x), z], axis=-1)


@dataclass(frozen=True)
class Case:
    """A case. name: its number in the thesis. first, last: samples about the point."""

    name: str
    what: str
    first: int
    last: int
    classes: tuple[str, ...]
    features: Features

    def labels(self, kind: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """[M] class of points of these kinds."""
        if len(self.classes) == len(KINDS):
            return kind
        return (kind == SLIPPING).astype(np.int64)


RISK = ("safe", "risky")
CASES = (
    Case("1", "raw, -3 .. +3 samples about the point", -3, 3, RISK, raw),
    Case(
        "2", "friction ratios, the normal kept from zero", -3, 3, RISK, friction_ratios
    ),
    Case("3", "first principal component and z", -3, 3, RISK, first_components),
    Case("4", "raw, -7 .. -1: prediction", -7, -1, RISK, raw),
    Case("5", "as 4, four classes", -7, -1, KINDS, raw),
)


def _direction(channels: FloatArray) -> FloatArray:
    """[S] unit vector of the largest variance of channels [.., S], positive on the whole."""
    flat = channels.reshape(-1, channels.shape[-1])
    weights = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][0]
    direction: FloatArray = weights * np.where(weights.sum() < 0.0, -1.0, 1.0)
    return direction
