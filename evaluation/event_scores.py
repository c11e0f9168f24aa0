"""What a user feels: risky events found and missed, false alarms a minute, how late, and how much
time was left.

An alarm is the moment at which the hand begins to be asked to act. It finds an event if it begins
between load onset and the loss of contact, give or take a collar: the truth is no sharper than
that. An alarm that was on before finds nothing (the event is missed, "already on"), and one that
belongs to no event is false. An event is found once; further alarms in it are neither found nor
false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import BoolArray, FloatArray
from edge_runtime.decision import DecisionRules
from evaluation.alarms import Answers, act_requests
from training.metrics import INTERVAL_PERCENT, draw_groups
from training.recording import Recording
from training.timeline import RiskyEvent

IntArray = npt.NDArray[np.int64]
COLLAR_S = 0.020
COLLARS_S = (0.020, 0.040)
CONFIDENCES = tuple(range(0, 1000, 10))
"""Thousandths of the votes from which one is chosen."""
DRAWS = 1000


@dataclass(frozen=True)
class Outcome:
    """One event: s from load onset to the alarm (None: missed), s of lead there was (None: gross
    slip not known)."""

    event: RiskyEvent
    alarm_s: float | None
    already_on: bool

    @property
    def delay_s(self) -> float | None:
        """From load onset to the alarm; below 0 within the collar."""
        return None if self.alarm_s is None else self.alarm_s - self.event.onset_s

    @property
    def lead_s(self) -> float | None:
        """From the alarm to gross slip; below 0 where the object slides already."""
        return (
            None
            if self.alarm_s is None or self.event.gross_s is None
            else self.event.gross_s - self.alarm_s
        )

    @property
    def available_s(self) -> float | None:
        """From load onset to gross slip."""
        return None if self.event.gross_s is None else self.event.gross_s - self.event.onset_s


@dataclass(frozen=True)
class EventMatch:
    """What became of one stream: outcomes of its events, times in s of false alarms, its length in
    minutes."""

    recording: Recording
    outcomes: tuple[Outcome, ...]
    false_s: tuple[float, ...]
    minutes: float


def match_alarms(recording: Recording, asked: BoolArray, collar_s: float = COLLAR_S) -> EventMatch:
    """Match the alarms of a stream, asked [T], with its events."""
    alarms_s = np.flatnonzero(_begins(asked)) / recording.rate_hz
    false = np.ones(len(alarms_s), dtype=np.bool_)
    outcomes = []
    for event in recording.events:
        within = _within(event, alarms_s, collar_s)
        before = min(
            max(int(np.ceil((event.onset_s - collar_s) * recording.rate_hz)) - 1, -1),
            len(asked) - 1,
        )
        already_on = bool(before >= 0 and asked[before])
        found = float(alarms_s[within][0]) if within.any() and not already_on else None
        outcomes.append(Outcome(event, found, already_on))
        false &= ~within
    return EventMatch(
        recording,
        tuple(outcomes),
        tuple(alarms_s[false].tolist()),
        len(asked) / recording.rate_hz / 60.0,
    )


def false_alarms(recording: Recording, asked: BoolArray, collar_s: float = COLLAR_S) -> IntArray:
    """[K] how many alarms of asked [T, K] belong to no event: as many as `heard` has, for many K at
    once."""
    false, t_s = _begins(asked), np.arange(len(asked)) / recording.rate_hz
    for event in recording.events:
        false[_within(event, t_s, collar_s)] = False
    return np.asarray(false.sum(axis=0), dtype=np.int64)


def _begins(asked: BoolArray) -> BoolArray:
    """[T, ..] where an alarm begins."""
    begins = asked.copy()
    begins[1:] &= ~asked[:-1]
    return begins


def _within(event: RiskyEvent, t_s: FloatArray, collar_s: float) -> BoolArray:
    return np.asarray((t_s >= event.onset_s - collar_s) & (t_s <= event.end_s + collar_s))


def match_all_alarms(
    answers: Sequence[Answers], rules: DecisionRules, permille: int, collar_s: float = COLLAR_S
) -> list[EventMatch]:
    """The same for streams as they were answered, asked to act from a confidence on."""
    asked = act_requests(answers, rules, [permille])
    return [
        match_alarms(one.recording, acted[:, 0], collar_s)
        for one, acted in zip(answers, asked, strict=True)
    ]


def choose_confidence(
    answers: Sequence[Answers], rules: DecisionRules, most_false_per_min: float
) -> int:
    """The lowest of CONFIDENCES with so few false alarms on streams that are not the ones to be
    scored."""
    asked = act_requests(answers, rules, CONFIDENCES)
    minutes = sum(len(one.situation) / one.recording.rate_hz for one in answers) / 60.0
    false = sum(
        false_alarms(one.recording, acted) for one, acted in zip(answers, asked, strict=True)
    )
    few = np.flatnonzero(false <= most_false_per_min * minutes)
    return CONFIDENCES[few[0]] if len(few) else CONFIDENCES[-1]


def event_scores(
    streams: Sequence[EventMatch], *, seed: int = 0, n_draws: int = DRAWS
) -> dict[str, Any]:
    """Figures of many streams as one JSON object; intervals over groups (people, or trials where
    nobody is named)."""
    outcomes = [one for stream in streams for one in stream.outcomes]
    groups = np.unique([stream.recording.group for stream in streams], return_inverse=True)[1]
    sums = np.zeros((groups.max(initial=-1) + 1, 4))
    for group, stream in zip(groups, streams, strict=True):
        found = sum(one.alarm_s is not None for one in stream.outcomes)
        sums[group] += [found, len(stream.outcomes), len(stream.false_s), stream.minutes]
    drawn = draw_groups(len(sums), n_draws, seed) @ sums if len(sums) > 1 else None
    found, events, false, minutes = sums.sum(axis=0).tolist()
    caught = [one for one in outcomes if one.alarm_s is not None]
    timed = [one for one in caught if one.event.gross_s is not None]
    return {
        "events": int(events),
        "found": int(found),
        "missed": int(events - found),
        "already_on": sum(one.already_on for one in outcomes),
        "minutes": minutes,
        "false_alarms": int(false),
        "recall": found / events if events else None,
        "recall_ci": _interval(drawn, 0, 1),
        "false_per_min": false / minutes if minutes else None,
        "false_per_min_ci": _interval(drawn, 2, 3),
        "false_per_hour": 60.0 * false / minutes if minutes else None,
        "delay_ms": spread([1e3 * _known(one.delay_s) for one in caught]),
        "lead_ms": spread([1e3 * _known(one.lead_s) for one in timed]),
        "available_ms": spread([1e3 * _known(one.available_s) for one in timed]),
        "lead_used": spread(
            [_known(one.delay_s) / max(_known(one.available_s), 1e-3) for one in timed]
        ),
        "in_time": sum(_known(one.lead_s) > 0.0 for one in timed) / events if events else None,
    }


def _known(value: float | None) -> float:
    assert value is not None
    return value


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Median, 5th and 95th percentile; None of nothing."""
    if not values:
        return None
    return {f"p{percent}": float(np.percentile(values, percent)) for percent in (5, 50, 95)}


def _interval(drawn: FloatArray | None, above: int, below: int) -> list[float] | None:
    """95 % interval of a ratio of sums over the draws; None where nothing can be drawn."""
    if drawn is None:
        return None
    ratios = drawn[drawn[:, below] > 0, above] / drawn[drawn[:, below] > 0, below]
    return (
        [float(edge) for edge in np.percentile(ratios, INTERVAL_PERCENT)] if len(ratios) else None
    )
