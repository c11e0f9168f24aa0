"""The rule of an adaptation: what a person's samples and others' slips make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from holdfast.core.contract import GRASP, RISKY_SLIP, SAFE_SLIP
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.sessions.adapt import LEAST_RECALL, HeldOutFigures, PersonEvidence
from holdfast.sessions.adapt_evidence import (
    MOST_NATS,
    CandidateRows,
    corrected,
    fit_correction,
    stream_of,
    with_offset,
)

RATE_HZ, VOTES, LENGTH = 100.0, 4096, 60
RULES = DecisionRules(act_samples=1, min_risky_permille=600)


def stream(number: int, *, slip: bool, alike: bool = False) -> CandidateRows:
    """A grip whose samples 20 to 39 have 80 % risky votes.

    In a slip feature 0 is high, in a hand-over low; alike: as in a slip.
    """
    rng = np.random.default_rng(number)
    phases = (Phase(0, 20, GRASP), Phase(20, 40, RISKY_SLIP if slip else SAFE_SLIP))
    recording = Recording(
        f"t{number}",
        f"t{number}",
        np.zeros((LENGTH, 3)),
        np.ones((LENGTH, 1), dtype=bool),
        RATE_HZ,
        "N",
        action="pull" if slip else "pass",
        phases=phases,
        events=(RiskyEvent(0.2, 0.3, 0.39),) if slip else (),
    )
    features = rng.normal(size=(LENGTH, 3)).astype(np.float32)
    features[20:40, 0] += 6.0 if slip or alike else -6.0
    votes = np.tile([0, VOTES, 0, 0], (LENGTH, 1))
    votes[20:40] = [0, 0, VOTES // 5, VOTES - VOTES // 5]
    unknown = np.arange(LENGTH) < 3
    found = {
        "votes": votes,
        "features": features,
        "unknown": unknown,
        "situation": np.argmax(votes, axis=1),
    }
    return stream_of(recording, found)


def passes(n: int = 8, *, alike: bool = False) -> list[CandidateRows]:
    return [stream(k, slip=False, alike=alike) for k in range(n)]


def evidence(*, alike: bool = False) -> PersonEvidence:
    return PersonEvidence(passes(alike=alike), slips(), RULES, None, VOTES)


def slips(n: int = 24) -> list[CandidateRows]:
    return [stream(100 + k, slip=True) for k in range(n)]


def test_hand_overs_that_look_like_no_slip_are_no_longer_called() -> None:
    point = evidence().choose()
    assert point.nats is not None
    assert (point.reached.called, point.reached.hand_overs) == (0, 8)
    assert point.reached.recall == 1.0
    fitted = evidence().correction(point)
    new = corrected(stream(999, slip=False), fitted, None)
    assert not ((new.situation == RISKY_SLIP) & (new.risky_permille >= 600)).any()
    kept = corrected(stream(998, slip=True), fitted, None)
    assert ((kept.situation == RISKY_SLIP) & (kept.risky_permille >= 600)).any()


def test_hand_overs_that_look_like_a_slip_stay_called_rather_than_slips_missed() -> (
    None
):
    for threshold_only in (True, False):
        point = evidence(alike=True).choose(threshold_only=threshold_only)
        assert point.reached.recall >= LEAST_RECALL


def test_a_threshold_alone_cannot_tell_votes_that_are_alike_apart() -> None:
    point = evidence().choose(threshold_only=True)
    assert point.nats is None
    assert (point.reached.called, point.reached.recall) == (8, 1.0)


def test_a_moved_rule_still_adds_exactly_and_keeps_more_or_fewer_risky_votes() -> None:
    fitted, one = fit_correction(passes(), slips(), VOTES), stream(5, slip=False)
    risky = [
        with_offset(fitted, nats)
        .corrected(one.features, one.votes)[:, RISKY_SLIP]
        .sum()
        for nats in (-MOST_NATS, 0.0, MOST_NATS)
    ]
    assert risky == sorted(risky)
    assert risky[0] < risky[-1]


def test_samples_that_cannot_be_called_and_unknown_ones_are_no_evidence() -> None:
    one = stream(1, slip=True)
    assert one.row.tolist() == list(range(20, 40))
    assert (one.answers.situation[:3] == UNKNOWN).all()


BASE = HeldOutFigures(
    recall=1.0,
    before_gross_slip=0.9,
    slips=10,
    found=9,
    hand_overs=8,
    called=4,
    called_samples=50,
)


@pytest.mark.parametrize(
    ("change", "ways"),
    [
        ({}, []),
        ({"recall": 0.99, "called": 0, "called_samples": 90}, []),
        ({"recall": 0.989}, ["recall 0.989, of the base 1.000"]),
        ({"found": 8}, ["slips of the person: 8 of 10 found, by the base 9"]),
        ({"called": 5}, ["voluntary actions called: 5 of 8, by the base 4"]),
    ],
)
def test_worse_is_a_recall_that_falls_by_more_than_a_hundredth_or_more_actions_called(
    change: dict[str, float], ways: list[str]
) -> None:
    assert replace(BASE, **change).worse_than(BASE) == ways  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change", [{"called": 3}, {"found": 10}, {"recall": 1.02, "called_samples": 60}]
)
def test_better_is_one_action_less_one_slip_more_or_a_hundredth_of_recall(
    change: dict[str, float],
) -> None:
    assert replace(BASE, **change).no_better_than(BASE) == []  # type: ignore[arg-type]
    (nothing,) = replace(BASE, called_samples=40).no_better_than(BASE)
    assert nothing.startswith("nothing is better: 4 of 8 voluntary actions called")
    worse = replace(BASE, called=5, found=10)
    assert worse.no_better_than(BASE) == worse.worse_than(BASE)
