"""The same streams on another hand: turned, mirrored, one sensor dead. What robustness is worth.

The readings are changed after they were prepared; that is the same, because preparation takes a
bias off each axis and treats x and y alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.contract import BoolArray, Json
from holdfast.data.recording import DataSet, Recording
from holdfast.evaluation.alarms import EventMatch, event_scores
from holdfast.evaluation.formats import share

SEED = 0
"""Of the angles, and of which sensor dies."""
DIES_S = 2.0
"""When a sensor dies in a stream; it stays dead."""
UNCHANGED = "unchanged"
Change = Callable[[Recording, BoolArray, np.random.Generator], Recording]


def on_hand(data: DataSet, name: str, thumb: BoolArray) -> DataSet:
    """A set as another hand would have felt it. thumb [S]: sensors on the thumb's side."""
    rng = np.random.default_rng(SEED)
    changed = [HANDS[name](one, thumb, rng) for one in data.recordings]
    return replace(data, recordings=changed)


def _turned(one: Recording, thumb: BoolArray, rng: np.random.Generator) -> Recording:
    """About the axis of the grip, by any angle; thumb and fingers face each other."""
    angle = rng.uniform(0.0, 2.0 * np.pi) * np.where(thumb, -1.0, 1.0)
    values = one.samples.reshape(len(one.samples), -1, 3).copy()
    shear = (values[..., 0] + 1j * values[..., 1]) * np.exp(1j * angle)
    values[..., 0] = shear.real
    values[..., 1] = shear.imag
    return replace(one, samples=values.reshape(one.samples.shape))


def _mirrored(one: Recording, thumb: BoolArray, rng: np.random.Generator) -> Recording:
    """A left hand: x of every sensor has the other sign."""
    values = one.samples.copy()
    values[:, 0::3] *= -1.0
    return replace(one, samples=values)


def _one_dead(one: Recording, thumb: BoolArray, rng: np.random.Generator) -> Recording:
    """A sensor, drawn a stream, is invalid from DIES_S on; its reading stands still."""
    which = int(rng.integers(one.n_sensors))
    at = round(DIES_S * one.rate_hz)
    values = one.samples.copy()
    values[at:, 3 * which : 3 * which + 3] = values[at, 3 * which : 3 * which + 3]
    valid = one.valid.copy()
    valid[at:, which] = False
    return replace(one, samples=values, valid=valid)


HANDS: dict[str, Change] = {
    "turned": _turned,
    "mirrored": _mirrored,
    "one dead": _one_dead,
}
"""Name of a hand -> what it does to a recording."""


def hand_figures(matches: Sequence[EventMatch]) -> Json:
    """What became of the slips of all streams on one hand."""
    scores = event_scores(matches)
    lead_s = [one.lead_s for match in matches for one in match.outcomes]
    in_time = share([lead is not None and lead > 0.0 for lead in lead_s])
    return {
        "recall": scores.recall,
        "recall_ci": scores.recall_ci,
        "in_time": in_time.share,
        "in_time_ci": in_time.share_ci,
        "false_per_min": scores.false_per_min,
        "false_per_min_ci": scores.false_per_min_ci,
        "delay_ms": None if scores.delay_ms is None else scores.delay_ms.p50,
    }
