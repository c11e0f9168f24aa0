"""Intervals of this study: of a difference between paired outcomes, and of a mean over hands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import binomtest, sem, t

from holdfast.training.metrics import Interval

EACH = 0.975
"""Two intervals of this level hold together with 95 % (Bonferroni)."""


def paired_change(
    outcomes: Mapping[str, bool], before: Mapping[str, bool]
) -> tuple[float | None, Interval | None]:
    """(share of `outcomes` minus that of `before`, its 95 % interval), over cases of both by key.

    Only cases that changed count: gained minus lost. Each of these shares has an exact interval, so
    the difference is never too narrow, also where nothing changed. None without a case.
    """
    both = [key for key in outcomes if key in before]
    n = len(both)
    if not n:
        return None, None
    now = np.array([outcomes[key] for key in both])
    then = np.array([before[key] for key in both])
    gained = int(np.sum(now & ~then))
    lost = int(np.sum(~now & then))
    more = binomtest(gained, n).proportion_ci(EACH, method="exact")
    less = binomtest(lost, n).proportion_ci(EACH, method="exact")
    low = float(more.low - less.high)
    high = float(more.high - less.low)
    return (gained - lost) / n, (low, high)


def mean_interval(values: Sequence[float]) -> Interval | None:
    """95 % interval of a mean of independent values from 0 to 1, by Student's t; None below two."""
    n = len(values)
    if n < 2:
        return None
    half = float(t.ppf(0.975, n - 1) * sem(values))
    mean = float(np.mean(values))
    return max(0.0, mean - half), min(1.0, mean + half)
