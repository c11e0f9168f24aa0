"""Alarms against events: what counts as found, as missed, as false, and how much of the lead was
left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hard_marks import COLLAR, EVENTS
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP
from holdfast.data.recording import Recording
from holdfast.data.timeline import RiskyEvent
from holdfast.edge_runtime.decision import (
    UNKNOWN,
    DecisionRules,
    DecisionState,
    decide,
    period_us,
)
from holdfast.evaluation.alarms import (
    CONFIDENCES,
    EventMatch,
    RecordingAnswers,
    act_requests,
    choose_confidence,
    event_scores,
    false_alarms,
    match_alarms,
    requests_at,
)
from holdfast.evaluation.formats import Spread

RATE_HZ = 100.0
EVENT = RiskyEvent(1.0, 1.05, 1.10)
RULES = DecisionRules()


def recording(*events: RiskyEvent, group: str = "a", length: int = 300) -> Recording:
    samples, valid = np.zeros((length, 3)), np.ones((length, 1), dtype=bool)
    return Recording("a", group, samples, valid, RATE_HZ, "N", events=events)


def requests(*spans: tuple[float, float], length: int = 300) -> np.ndarray:
    """[T] an act is requested from .. to, in s."""
    t_s = np.arange(length) / RATE_HZ
    on = np.zeros(length, dtype=bool)
    for from_s, to_s in spans:
        on |= (t_s >= from_s - 1e-9) & (t_s < to_s - 1e-9)
    return on


def match_at(*spans: tuple[float, float]) -> EventMatch:
    return match_alarms(recording(EVENT), requests(*spans))


def p50(of: Spread | None) -> float:
    assert of is not None
    return of.p50


# -- the decision, many streams at once

PERIOD = period_us(RATE_HZ)


def one_by_one(stream: RecordingAnswers) -> list[list[int]]:
    return np.column_stack([stream.situation, stream.risky_permille]).tolist()


@given(
    labels=st.lists(
        st.lists(st.tuples(st.integers(-1, 3), st.integers(0, 1000)), max_size=60),
        min_size=1,
        max_size=4,
    ),
    confidences=st.lists(st.integers(0, 1000), min_size=1, max_size=3),
    debounce=st.integers(1, 4),
    release=st.integers(1, 4),
    evidence_ms=st.integers(1, 200),
)
def test_many_streams_at_once_are_decided_as_each_is_sample_by_sample(
    labels, confidences, debounce, release, evidence_ms
):
    rules = DecisionRules(
        act_samples=debounce, release_samples=release, evidence_ms=evidence_ms
    )
    streams = []
    for one in labels:
        situation, permille = np.array(one, dtype=np.int64).reshape(-1, 2).T
        streams.append(RecordingAnswers(recording(), situation, permille))
    together = act_requests(streams, rules, confidences)
    for stream, acted in zip(streams, together, strict=True):
        for k, least in enumerate(confidences):
            at_least = replace(rules, min_risky_permille=least)
            state = DecisionState()
            alone = []
            for situation, permille in one_by_one(stream):
                state = decide(at_least, state, situation, permille, period_us=PERIOD)
                alone.append(state.act)
            assert acted[:, k].tolist() == alone


# -- an alarm and an event


@given(
    st.lists(st.lists(st.booleans(), min_size=3, max_size=3), min_size=14, max_size=38)
)
def test_false_alarms_of_many_confidences_are_those_that_each_alone_has(result):
    rows = np.repeat(np.array(result), 8, axis=0)
    alone = [len(match_alarms(recording(EVENT), rows[:, k]).false_s) for k in range(3)]
    assert false_alarms(recording(EVENT), rows).tolist() == alone


@pytest.mark.parametrize(
    ("from_s", "found", "false"),
    [(0.98, 1, 0), (0.97, 0, 1), (1.12, 1, 0), (1.13, 0, 1)],
)
def test_the_collar_is_twenty_milliseconds_on_both_sides(from_s, found, false):
    on = requests((from_s, from_s + 0.01))
    matched = match_alarms(recording(EVENT), on)
    assert (matched.outcomes[0].alarm_s is not None, len(matched.false_s)) == (
        found,
        false,
    )
    wide = match_alarms(recording(EVENT), on, collar_s=0.040)
    assert wide.outcomes[0].alarm_s is not None


@EVENTS.mark
def test_an_alarm_that_was_on_before_detects_nothing_and_is_false():
    matched = match_at((0.5, 2.0))
    assert matched.outcomes[0].alarm_s is None
    assert matched.outcomes[0].already_on
    assert matched.false_s == (0.5,)


@EVENTS.unguarded
def test_counted_sample_by_sample_an_alarm_that_never_ends_finds_every_event():
    always = requests((0.0, 3.0))
    assert always[round(EVENT.onset_s * RATE_HZ) : round(EVENT.end_s * RATE_HZ)].all()
    assert match_at((0.0, 3.0)).outcomes[0].alarm_s is None


@COLLAR.mark
def test_an_event_is_detected_once_and_a_second_alarm_in_it_is_not_false():
    matched = match_at((1.01, 1.03), (1.05, 1.2))
    assert matched.outcomes[0].delay_s == pytest.approx(0.01)
    assert matched.false_s == ()


@COLLAR.mark
def test_two_events_inside_one_collar_share_an_alarm_that_begins_in_both():
    second = RiskyEvent(1.11, 1.15, 1.20)
    matched = match_alarms(recording(EVENT, second), requests((1.10, 1.3)))
    assert [one.alarm_s for one in matched.outcomes] == [1.10, 1.10]
    assert matched.outcomes[1].delay_s == pytest.approx(-0.01)


# -- figures of many streams


def stream(
    group: str, *alarms: tuple[float, float], events: tuple[RiskyEvent, ...] = (EVENT,)
) -> EventMatch:
    return match_alarms(recording(*events, group=group), requests(*alarms))


def test_figures_count_what_was_found_missed_false_and_already_on():
    alarms = {"a": (1.02, 1.2), "b": (0.5, 2.0), "c": (0.0, 0.0), "d": (2.0, 2.1)}
    scores = event_scores([stream(group, span) for group, span in alarms.items()])
    assert (scores.found, scores.missed, scores.already_on) == (1, 3, 1)
    assert (scores.events, scores.recall) == (4, 0.25)
    assert scores.false_alarms == 2
    assert scores.false_per_min == pytest.approx(2 / (4 * 3 / 60))
    assert scores.false_per_hour == pytest.approx(60 * scores.false_per_min)
    assert p50(scores.delay_ms) == pytest.approx(20.0)
    assert p50(scores.lead_used) == pytest.approx(0.4)
    assert scores.in_time == 0.25
    assert scores.recall_ci is not None
    assert scores.recall_ci[0] <= 0.25 <= scores.recall_ci[1]


def test_an_unknown_gross_slip_gives_a_delay_and_no_lead():
    scores = event_scores(
        [stream("a", (1.02, 1.2), events=(RiskyEvent(1.0, None, 1.1),))]
    )
    assert p50(scores.delay_ms) == pytest.approx(20.0)
    assert (scores.lead_ms, scores.lead_used, scores.in_time) == (None, None, None)
    # of several, only those count whose gross slip is known, also where they are missed
    known = stream("b", (1.02, 1.2))
    unknown = stream("c", events=(RiskyEvent(1.0, None, 1.1),))
    assert event_scores([known, unknown]).in_time == 1.0
    assert event_scores([known, unknown, stream("d")]).in_time == 0.5


@EVENTS.mark
def test_streams_without_events_have_no_recall_and_one_group_has_no_interval():
    scores = event_scores([stream("a", (1.0, 1.1), events=())])
    assert (scores.recall, scores.recall_ci, scores.false_per_min_ci) == (
        None,
        None,
        None,
    )
    assert scores.false_per_min == pytest.approx(20.0)


# -- the threshold


def answers(permille_of_an_alarm: int) -> RecordingAnswers:
    """A stream with one false alarm of some confidence, and a sure alarm at the event."""
    situation, permille = np.full(300, GRASP), np.zeros(300, dtype=np.int64)
    for first, sure in ((50, permille_of_an_alarm), (101, 995)):
        situation[first : first + 3], permille[first : first + 3] = RISKY_SLIP, sure
        situation[first + 3 : first + 9] = NOTHING
    situation[:10] = UNKNOWN
    return RecordingAnswers(recording(EVENT), situation, permille)


def test_the_confidence_is_the_lowest_that_leaves_no_more_false_alarms_than_allowed():
    streams = [answers(400), answers(601)]
    per_min = 1 / (2 * 3 / 60)
    for allowed, expected in ((2, 0), (1, 410), (0.5, 610)):
        permille = choose_confidence(streams, RULES, allowed * per_min)
        acts = requests_at(streams, RULES, permille)
        pairs = zip(streams, acts, strict=True)
        scores = event_scores([match_alarms(one.recording, on) for one, on in pairs])
        assert permille == expected
        assert (scores.false_alarms, scores.found) == (int(allowed), 2)
    assert choose_confidence([answers(999)], RULES, 0.0) == CONFIDENCES[-1], (
        "none is enough, so the highest is taken"
    )
