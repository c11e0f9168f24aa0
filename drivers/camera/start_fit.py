"""When a motion began: a quadratic fitted to its first frames."""

from __future__ import annotations

import numpy as np

from holdfast.drivers.camera.motion import REST_S
from holdfast.edge_runtime.contract import FloatArray

FIT_FRAMES, FIT_THRESHOLDS = 4, 20.0
"""The fit covers the rest, this many moving frames, and later ones up to this many thresholds away.

Further on, the acceleration is no longer that of the start."""
STEPS = 400
"""Points of the grid on which the start is searched."""


def fitted_start(
    t_s: FloatArray, along_mm: FloatArray, first: int, threshold_mm: float, sigma_mm: float
) -> tuple[float, float]:
    """Start of c + k (t - start)^2, 0 before it, by least squares, and its standard deviation, s.

    first: the first frame beyond the threshold. The fit covers the rest before it and the first
    frames after it. The start is searched on a grid, then on a finer one around the best point,
    because the model has a corner there. The standard deviation comes from the model's slopes and
    from the larger of residual and noise.
    """
    stop = min(first + FIT_FRAMES, len(t_s))
    while (
        stop < len(t_s)
        and along_mm[stop] <= FIT_THRESHOLDS * threshold_mm
        and t_s[stop] - t_s[first] < REST_S
    ):
        stop += 1
    begin = int(np.searchsorted(t_s, t_s[first] - REST_S))
    t, d = t_s[begin:stop], along_mm[begin:stop]
    low, high = t_s[begin], t_s[first]
    for _ in range(2):
        grid = np.linspace(low, high, STEPS)
        best = int(np.argmin(_misfit(t, d, grid)))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, STEPS - 1)]
    start_s = float(grid[best])
    since = np.maximum(t - start_s, 0.0)
    known = np.stack([np.ones_like(since), since**2], axis=1)
    solved = np.linalg.lstsq(known, d, rcond=None)[0]
    left = d - known @ solved
    slopes = np.column_stack([known, -2.0 * solved[1] * since])
    noise_mm = max(sigma_mm, float(np.sqrt(left @ left / max(len(t) - 3, 1))))
    spread = np.linalg.pinv(slopes.T @ slopes)
    return start_s, noise_mm * float(np.sqrt(max(spread[2, 2], 0.0)))


def _misfit(t: FloatArray, d: FloatArray, starts: FloatArray) -> FloatArray:
    """[G] squared residual of the best line in (t - start)^2, for every start."""
    x = np.maximum(t - starts[:, None], 0.0) ** 2
    x -= x.mean(axis=1, keepdims=True)
    y = d - d.mean()
    bent, square = x @ y, (x * x).sum(axis=1)
    misfit: FloatArray = y @ y - np.where(
        (bent > 0.0) & (square > 0.0), bent, 0.0
    ) ** 2 / np.maximum(square, 1e-300)
    return misfit
