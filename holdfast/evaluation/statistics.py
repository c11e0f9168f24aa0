"""Figures that every table uses: a spread of times, a share with its interval, McNemar's test.

Shares of things that happen once a trial (a voluntary action, a hold) have exact binomial intervals
(Clopper & Pearson, Biometrika 26, 1934): a bootstrap of a share of one gives 1 to 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from holdfast.core.contract import BoolArray
from holdfast.training.figures import Share


@dataclass(frozen=True)
class Spread:
    """The 5th, 50th (median) and 95th percentile, in the unit of the values."""

    p5: float
    p50: float
    p95: float


def spread(values: Sequence[float]) -> Spread | None:
    """The percentiles of some values; None without a value."""
    if not values:
        return None
    # No mean: a single alarm that came seconds late would move it.
    p5, p50, p95 = np.percentile(values, (5, 50, 95)).tolist()
    return Spread(p5, p50, p95)


def share(hits: Sequence[bool]) -> Share:
    """The share of the hits that are true, and its exact interval."""
    n = len(hits)
    # Nothing happened, so there is no share, and no interval of one.
    if not n:
        return Share(None, None, 0)
    n_true = sum(hits)
    # Clopper and Pearson: never too narrow, however few the trials are.
    exact = binomtest(n_true, n).proportion_ci(0.95, method="exact")
    interval = (float(exact.low), float(exact.high))
    return Share(n_true / n, interval, n)


@dataclass(frozen=True)
class McNemar:
    """Events that only one of two methods detected, and the exact two-sided p of that split."""

    only_ours: int
    only_theirs: int
    both: int
    neither: int
    p: float


def mcnemar(ours: BoolArray, theirs: BoolArray) -> McNemar:
    """Compare two methods [E], [E] event by event."""
    only_ours = int((ours & ~theirs).sum())
    only_theirs = int((theirs & ~ours).sum())
    both = int((ours & theirs).sum())
    neither = int((~ours & ~theirs).sum())
    # Events on which both agree say nothing about which is better.
    n = only_ours + only_theirs
    # Without a difference both are equally likely to win each event: p = 1.
    p = float(binomtest(only_ours, n, 0.5).pvalue) if n else 1.0
    return McNemar(only_ours, only_theirs, both, neither, p)
