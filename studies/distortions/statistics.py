"""The interval of a mean over hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import sem, t

from holdfast.data.metrics import Interval


def mean_interval(values: Sequence[float]) -> Interval | None:
    """95 % interval of a mean of independent values from 0 to 1, by Student's t; None below two."""
    n = len(values)
    if n < 2:
        return None
    half = float(t.ppf(0.975, n - 1) * sem(values))
    mean = float(np.mean(values))
    return max(0.0, mean - half), min(1.0, mean + half)
