"""Alarms against events: recall, false alarms a minute, delay, and the lead that was left.

An act is requested on a stream by the decision of the hand (edge_runtime/decision.py), here for
many confidences at once. An alarm is the moment at which a request begins. It detects an event if
it begins between load onset and the loss of contact, give or take a collar: the truth is no
sharper. An alarm that was on before detects nothing (the event is missed, "already on"). An alarm
that belongs to no event is false. An event is detected once; further alarms in it are neither
detections nor false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NOTHING, RISKY_SLIP, BoolArray, FloatArray
from holdfast.data.metrics import Interval, draw_groups, interval_of
from holdfast.data.recording import Recording
from holdfast.data.timeline import RiskyEvent
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules, period_us
from holdfast.evaluation.formats import Spread, spread

IntArray = npt.NDArray[np.int64]
COLLAR_S = 0.020
"""How far outside an event an alarm still belongs to it: 3 samples at 150 Hz."""
WIDE_COLLAR_S = 0.040
"""A second collar, to show how much the figures depend on the first."""
CONFIDENCES = tuple(range(0, 1000, 10))
"""Thousandths of the votes from which one is chosen."""
DRAWS = 1000
"""Of the bootstrap over groups."""


@dataclass(frozen=True)
class RecordingAnswers:
    """One recording as it was answered, sample by sample from its first one on.

    situation: [T], UNKNOWN or 0..3. risky_permille: [T], thousandths of the votes (or of the
    probability).
    """

    recording: Recording
    situation: IntArray
    risky_permille: IntArray


def act_requests(
    answers: Sequence[RecordingAnswers],
    rules: DecisionRules,
    min_risky_permille: Sequence[int],
) -> list[BoolArray]:
    """[T, K] a stream: whether an act is requested, at each of K confidences.

    Sample by sample the same as `decide` with neither opening command nor override.
    """
    least = np.asarray(min_risky_permille)
    return [_requests(one, rules, least) for one in answers]


def requests_at(
    answers: Sequence[RecordingAnswers], rules: DecisionRules, permille: int
) -> list[BoolArray]:
    """[T] a stream: whether an act is requested, from one confidence on."""
    return [on[:, 0] for on in act_requests(answers, rules, [permille])]


def _requests(
    answers: RecordingAnswers, rules: DecisionRules, least: IntArray
) -> BoolArray:
    """A request lasts from its last call until release, or until evidence is missing for too long.

    An unknown sample neither calls nor releases, and breaks no run of samples that do.
    """
    # Unknown samples are taken out first, so they break no run, and filled in at the end.
    known = np.flatnonzero(answers.situation != UNKNOWN)
    situation = answers.situation[known][:, None]
    confident = answers.risky_permille[known, None] >= least
    # One column for each confidence: the debounce runs once for all of them.
    risky = (situation == RISKY_SLIP) & confident
    calls = _lasting(risky, rules.act_samples)

    # Rounded up: evidence may be missing for whole sample periods only.
    period = period_us(answers.recording.rate_hz)
    patience = -(-1000 * rules.evidence_ms // period)
    # An empty hand has nothing left to act on.
    released = _lasting(situation == NOTHING, rules.release_samples)
    lets_go = released | _lasting(~risky, patience)

    # Row 0 is the state before the first known sample: nothing is requested.
    requested = np.zeros((1 + len(known), len(least)), dtype=np.bool_)
    called = _last(calls)
    # Where both fall on one sample, the call wins, as it does on the hand.
    requested[1:] = (called > 0) & (called >= _last(lets_go))
    # Unknown samples keep the state of the last known one before them.
    every_row = np.arange(len(answers.situation))
    # A sample after k known ones has the state of row k.
    known_before = np.searchsorted(known, every_row, side="right")
    return requested[known_before]


def _lasting(flags: BoolArray, samples: int) -> BoolArray:
    """[T, K] where a flag has been up for this many samples."""
    if samples <= 1:
        return flags
    # Samples since the flag was last down.
    return np.asarray(_turns(flags) - _last(~flags) >= samples)


def _last(flags: BoolArray) -> npt.NDArray[np.int32]:
    """[T, K] the turn, from 1, at which a flag was last up, 0 before its first."""
    turn_or_0 = np.where(flags, _turns(flags), np.int32(0))
    return np.maximum.accumulate(turn_or_0, axis=0)


def _turns(flags: BoolArray) -> npt.NDArray[np.int32]:
    """[T, 1] numbers of the samples, from 1."""
    return np.arange(1, 1 + len(flags), dtype=np.int32)[:, None]


@dataclass(frozen=True)
class AlarmOutcome:
    """One event and its alarm, in s of the stream. alarm_s: None where it was missed."""

    event: RiskyEvent
    alarm_s: float | None
    already_on: bool

    @property
    def delay_s(self) -> float | None:
        """From load onset to the alarm; below 0 within the collar. None where it is not known."""
        if self.alarm_s is None or not self.event.timed:
            return None
        return self.alarm_s - self.event.onset_s

    @property
    def lead_s(self) -> float | None:
        """From the alarm to gross slip; below 0 where the object slides already."""
        if self.alarm_s is None or self.event.gross_s is None:
            return None
        return self.event.gross_s - self.alarm_s

    @property
    def available_s(self) -> float | None:
        """From load onset to gross slip."""
        if self.event.gross_s is None:
            return None
        return self.event.gross_s - self.event.onset_s


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
    rate_hz = recording.rate_hz
    # In s, as the truth has its events.
    alarms = np.flatnonzero(_begins(requests))
    alarms_s = alarms / rate_hz
    false = recording.counted(len(requests))[alarms]
    outcomes = []
    for event in recording.events:
        # The truth is no sharper than the collar, so an alarm within it belongs to the event.
        within = within_event(event, alarms_s, collar_s)

        # The last sample before the collar: a request there is not an answer to this event.
        first_s = event.onset_s - collar_s
        last_before = int(np.ceil(first_s * rate_hz)) - 1
        # An event may begin beyond the end of a stream that was cut.
        last_before = min(last_before, len(requests) - 1)
        already_on = last_before >= 0 and bool(requests[last_before])
        alarm_s = None
        # The first alarm is the one that the hand acts on; one after lost samples is chance.
        if within.any() and not already_on and not event.lost:
            alarm_s = float(alarms_s[within][0])

        outcomes.append(AlarmOutcome(event, alarm_s, already_on))
        # An alarm inside any event is not false, also where another one detected it.
        false &= ~within

    false_s = tuple(alarms_s[false].tolist())
    minutes = recording.counted_s(len(requests)) / 60.0
    return EventMatch(recording, tuple(outcomes), false_s, minutes)


def false_alarms(recording: Recording, requests: BoolArray) -> IntArray:
    """[K] how many alarms of requests [T, K] belong to no event, as `match_alarms` counts them."""
    false = _begins(requests) & recording.counted(len(requests))[:, None]
    t_s = np.arange(len(requests)) / recording.rate_hz
    for event in recording.events:
        false[within_event(event, t_s, COLLAR_S)] = False
    return np.asarray(false.sum(axis=0), dtype=np.int64)


def _begins(requests: BoolArray) -> BoolArray:
    """[T, ..] where an alarm begins."""
    # A request at the first sample begins there.
    begins = requests.copy()
    # Only the change from no request to a request is an alarm.
    begins[1:] &= ~requests[:-1]
    return begins


def within_event(event: RiskyEvent, t_s: FloatArray, collar_s: float) -> BoolArray:
    """Where times [T] lie in an event or its collar."""
    after_onset = t_s >= event.onset_s - collar_s
    before_end = t_s <= event.end_s + collar_s
    return np.asarray(after_onset & before_end)


def choose_confidence(
    answers: Sequence[RecordingAnswers], rules: DecisionRules, most_false_per_min: float
) -> int:
    """The lowest of CONFIDENCES that allows so few false alarms.

    answers: of streams that are not scored later.
    """
    requests = act_requests(answers, rules, CONFIDENCES)
    false = np.zeros(len(CONFIDENCES), dtype=np.int64)
    seconds = 0.0
    for one, of_one in zip(answers, requests, strict=True):
        # All confidences at once: column k is confidence k.
        false += false_alarms(one.recording, of_one)
        seconds += one.recording.counted_s(len(one.situation))

    # As a count: a rate would have to be divided by the minutes for each confidence.
    allowed = most_false_per_min * (seconds / 60.0)
    few = np.flatnonzero(false <= allowed)
    # The lowest is the one that detects most; where none is quiet enough, the quietest.
    return CONFIDENCES[few[0]] if len(few) else CONFIDENCES[-1]


@dataclass(frozen=True)
class AlarmRates:
    """Share of the events that were detected, and false alarms a minute; intervals over groups."""

    recall: float | None
    recall_ci: Interval | None
    false_per_min: float | None
    false_per_min_ci: Interval | None


@dataclass(frozen=True)
class EventScores(AlarmRates):
    """Alarms of many streams against their events.

    already_on: events missed because the hand acted before them. delay_ms: load onset to alarm.
    lead_ms: alarm to gross slip. available_ms: load onset to gross slip. lead_used: share of that
    time that had passed at the alarm. in_time: share of the events acted on before gross slip, of
    those whose gross slip is known.
    """

    events: int
    found: int
    missed: int
    already_on: int
    minutes: float
    false_alarms: int
    false_per_hour: float | None
    delay_ms: Spread | None
    lead_ms: Spread | None
    available_ms: Spread | None
    lead_used: Spread | None
    in_time: float | None

    @property
    def share_of_lead(self) -> Spread | None:
        """The share of the lead that was used, 0 to 1, for people to read.

        1 where the object slid before the request: no more than the whole lead can be used. None
        where the median lead is no longer than the collar: the truth is not that sharp.
        """
        used, available = self.lead_used, self.available_ms
        if used is None or available is None or available.p50 <= 1e3 * COLLAR_S:
            return None
        # Percentiles of limited values are the limited percentiles.
        p5, p50, p95 = np.clip((used.p5, used.p50, used.p95), 0.0, 1.0).tolist()
        return Spread(p5, p50, p95)


@dataclass
class EventTimes:
    """ms of the detected events: load onset to alarm; alarm to gross slip, and onset to gross slip.

    lead_used: share of the time to gross slip that had passed. in_time: how many were acted on
    before it. The last three are of events whose gross slip the truth knows; of_known_gross counts
    these, the missed ones too.
    """

    delay_ms: list[float]
    lead_ms: list[float]
    available_ms: list[float]
    lead_used: list[float]
    in_time: int = 0
    of_known_gross: int = 0

    def add(self, outcome: AlarmOutcome) -> None:
        self.of_known_gross += outcome.event.gross_s is not None
        # A missed event has no delay; it lowers the recall instead.
        if outcome.delay_s is None:
            return
        self.delay_ms.append(1e3 * outcome.delay_s)
        if outcome.lead_s is None or outcome.available_s is None:
            return

        self.lead_ms.append(1e3 * outcome.lead_s)
        self.available_ms.append(1e3 * outcome.available_s)
        # A lead of nothing would divide by 0: at least 1 ms.
        self.lead_used.append(outcome.delay_s / max(outcome.available_s, 1e-3))
        self.in_time += outcome.lead_s > 0.0


def event_times(matches: Sequence[EventMatch]) -> EventTimes:
    """Times of the events of many streams."""
    times = EventTimes([], [], [], [])
    for match in matches:
        for outcome in match.outcomes:
            times.add(outcome)
    return times


def event_scores(streams: Sequence[EventMatch], *, seed: int = 0) -> EventScores:
    """Figures of many streams; groups are people, or trials where no person is named."""
    times = event_times(streams)
    already_on = 0
    for stream in streams:
        already_on += sum(one.already_on for one in stream.outcomes)

    # Recordings of a person are alike, so the bootstrap draws groups and no single events.
    sums = _sums_by_group(streams)
    drawn = None
    if len(sums) > 1:
        drawn = draw_groups(len(sums), DRAWS, seed) @ sums

    found, events, false, minutes = sums.sum(axis=0).tolist()
    false_per_min = false / minutes if minutes else None

    return EventScores(
        events=int(events),
        found=int(found),
        missed=int(events - found),
        already_on=already_on,
        minutes=minutes,
        false_alarms=int(false),
        recall=found / events if events else None,
        recall_ci=ratio_interval(drawn, 0, 1),
        false_per_min=false_per_min,
        false_per_min_ci=ratio_interval(drawn, 2, 3),
        false_per_hour=60.0 * false / minutes if minutes else None,
        delay_ms=spread(times.delay_ms),
        lead_ms=spread(times.lead_ms),
        available_ms=spread(times.available_ms),
        lead_used=spread(times.lead_used),
        in_time=times.in_time / times.of_known_gross if times.of_known_gross else None,
    )


def _sums_by_group(streams: Sequence[EventMatch]) -> FloatArray:
    """[G, 4] events detected, events, false alarms and minutes of each group."""
    names = [stream.recording.group for stream in streams]
    _, groups = np.unique(names, return_inverse=True)
    sums = np.zeros((groups.max(initial=-1) + 1, 4))
    for group, stream in zip(groups, streams, strict=True):
        # Sums and not ratios: a draw adds up its groups before it divides.
        detected = sum(one.alarm_s is not None for one in stream.outcomes)
        events = len(stream.outcomes)
        false = len(stream.false_s)
        sums[group] += [detected, events, false, stream.minutes]

    return sums


def ratio_interval(drawn: FloatArray | None, above: int, below: int) -> Interval | None:
    """Interval of a ratio of two columns of sums [draws, ..]; None where nothing can be drawn."""
    if drawn is None:
        return None
    # A draw of groups that have no event, or no minute, has no ratio.
    defined = drawn[drawn[:, below] > 0]
    return interval_of(defined[:, above] / defined[:, below])
