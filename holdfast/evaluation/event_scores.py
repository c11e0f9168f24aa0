"""Alarms against events: recall, false alarms a minute, delay, and the lead that was left.

An alarm is the moment at which a request to act begins. It detects an event if it begins
between load onset and the loss of contact, give or take a collar: the truth is no sharper. An alarm
that was on before detects nothing (the event is missed, "already on"). An alarm that belongs to no
event is false. An event is detected once; further alarms in it are neither detections nor false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.evaluation.alarms import Answers, act_requests
from holdfast.evaluation.statistics import Spread, ratio_interval, spread
from holdfast.training.figures import Interval
from holdfast.training.metrics import draw_groups
from holdfast.training.recording import Recording
from holdfast.training.timeline import RiskyEvent

IntArray = npt.NDArray[np.int64]
COLLAR_S = 0.020
COLLARS_S = (0.020, 0.040)
CONFIDENCES = tuple(range(0, 1000, 10))
"""Thousandths of the votes from which one is chosen."""
DRAWS = 1000


@dataclass(frozen=True)
class AlarmOutcome:
    """One event and its alarm, in s of the stream. alarm_s: None where it was missed."""

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
        gross_s = self.event.gross_s
        return (
            None if self.alarm_s is None or gross_s is None else gross_s - self.alarm_s
        )

    @property
    def available_s(self) -> float | None:
        """From load onset to gross slip."""
        return (
            None
            if self.event.gross_s is None
            else self.event.gross_s - self.event.onset_s
        )


@dataclass(frozen=True)
class EventMatch:
    """One stream: what became of its events, times in s of its false alarms, its minutes."""

    recording: Recording
    outcomes: tuple[AlarmOutcome, ...]
    false_s: tuple[float, ...]
    minutes: float


def match_alarms(
    recording: Recording, requests: BoolArray, collar_s: float = COLLAR_S
) -> EventMatch:
    """Match the alarms of a stream with its events. requests [T]: an act is requested."""
    alarms_s = np.flatnonzero(_begins(requests)) / recording.rate_hz
    false = np.ones(len(alarms_s), dtype=np.bool_)
    outcomes = []
    for event in recording.events:
        within = _within(event, alarms_s, collar_s)
        before = int(np.ceil((event.onset_s - collar_s) * recording.rate_hz)) - 1
        before = min(max(before, -1), len(requests) - 1)
        already_on = bool(before >= 0 and requests[before])
        alarm_s = (
            float(alarms_s[within][0]) if within.any() and not already_on else None
        )
        outcomes.append(AlarmOutcome(event, alarm_s, already_on))
        false &= ~within
    minutes = len(requests) / recording.rate_hz / 60.0
    return EventMatch(
        recording, tuple(outcomes), tuple(alarms_s[false].tolist()), minutes
    )


def false_alarms(
    recording: Recording, requests: BoolArray, collar_s: float = COLLAR_S
) -> IntArray:
    """[K] how many alarms of requests [T, K] belong to no event, as `match_alarms` counts them."""
    false, t_s = _begins(requests), np.arange(len(requests)) / recording.rate_hz
    for event in recording.events:
        false[_within(event, t_s, collar_s)] = False
    return np.asarray(false.sum(axis=0), dtype=np.int64)


def _begins(requests: BoolArray) -> BoolArray:
    """[T, ..] where an alarm begins."""
    begins = requests.copy()
    begins[1:] &= ~requests[:-1]
    return begins


def _within(event: RiskyEvent, t_s: FloatArray, collar_s: float) -> BoolArray:
    return np.asarray(
        (t_s >= event.onset_s - collar_s) & (t_s <= event.end_s + collar_s)
    )


def match_all_alarms(
    answers: Sequence[Answers],
    rules: DecisionRules,
    permille: int,
    collar_s: float = COLLAR_S,
) -> list[EventMatch]:
    """Match many answered streams. permille: the confidence from which an act is requested."""
    requests = act_requests(answers, rules, [permille])
    return [
        match_alarms(one.recording, of_one[:, 0], collar_s)
        for one, of_one in zip(answers, requests, strict=True)
    ]


def choose_confidence(
    answers: Sequence[Answers], rules: DecisionRules, most_false_per_min: float
) -> int:
    """The lowest of CONFIDENCES that allows so few false alarms.

    answers: of streams that are not scored later.
    """
    requests = act_requests(answers, rules, CONFIDENCES)
    minutes = sum(len(one.situation) / one.recording.rate_hz for one in answers) / 60.0
    false = sum(
        false_alarms(one.recording, of_one)
        for one, of_one in zip(answers, requests, strict=True)
    )
    few = np.flatnonzero(false <= most_false_per_min * minutes)
    return CONFIDENCES[few[0]] if len(few) else CONFIDENCES[-1]


@dataclass(frozen=True)
class EventScores:
    """Alarms of many streams against their events; intervals are over groups.

    already_on: events missed because the hand acted before them. delay_ms: load onset to alarm.
    lead_ms: alarm to gross slip. available_ms: load onset to gross slip. lead_used: share of that
    time that had passed at the alarm. in_time: share of the events acted on before gross slip.
    """

    events: int
    found: int
    missed: int
    already_on: int
    minutes: float
    false_alarms: int
    recall: float | None
    recall_ci: Interval | None
    false_per_min: float | None
    false_per_min_ci: Interval | None
    false_per_hour: float | None
    delay_ms: Spread | None
    lead_ms: Spread | None
    available_ms: Spread | None
    lead_used: Spread | None
    in_time: float | None


def event_scores(
    streams: Sequence[EventMatch], *, seed: int = 0, n_draws: int = DRAWS
) -> EventScores:
    """Figures of many streams; groups are people, or trials where no person is named."""
    outcomes = [one for stream in streams for one in stream.outcomes]
    sums = _sums_by_group(streams)
    drawn = draw_groups(len(sums), n_draws, seed) @ sums if len(sums) > 1 else None
    found, events, false, minutes = sums.sum(axis=0).tolist()
    detected = [one for one in outcomes if one.alarm_s is not None]
    timed = [one for one in detected if one.event.gross_s is not None]
    lead_used = [
        _known(one.delay_s) / max(_known(one.available_s), 1e-3) for one in timed
    ]
    return EventScores(
        events=int(events),
        found=int(found),
        missed=int(events - found),
        already_on=sum(one.already_on for one in outcomes),
        minutes=minutes,
        false_alarms=int(false),
        recall=found / events if events else None,
        recall_ci=ratio_interval(drawn, 0, 1),
        false_per_min=false / minutes if minutes else None,
        false_per_min_ci=ratio_interval(drawn, 2, 3),
        false_per_hour=60.0 * false / minutes if minutes else None,
        delay_ms=spread([1e3 * _known(one.delay_s) for one in detected]),
        lead_ms=spread([1e3 * _known(one.lead_s) for one in timed]),
        available_ms=spread([1e3 * _known(one.available_s) for one in timed]),
        lead_used=spread(lead_used),
        in_time=sum(_known(one.lead_s) > 0.0 for one in timed) / events
        if events
        else None,
    )


def _sums_by_group(streams: Sequence[EventMatch]) -> FloatArray:
    """[G, 4] events detected, events, false alarms and minutes of each group."""
    groups = np.unique(
        [stream.recording.group for stream in streams], return_inverse=True
    )[1]
    sums = np.zeros((groups.max(initial=-1) + 1, 4))
    for group, stream in zip(groups, streams, strict=True):
        detected = sum(one.alarm_s is not None for one in stream.outcomes)
        sums[group] += [
            detected,
            len(stream.outcomes),
            len(stream.false_s),
            stream.minutes,
        ]
    return sums


def _known(value: float | None) -> float:
    assert value is not None
    return value
