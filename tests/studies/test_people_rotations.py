"""Rotations of a pinched object: what two pads would feel of it, and both files side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.evaluation.alarms import EventMatch, match_alarms
from studies.people.rotations import compared, on_two_pads

RATE_HZ = 60.0


def pinched(person: str = "a") -> Recording:
    """Two seconds, a taxel of 1 N and one of 3 N; turned by 5 degrees at 1 s, by 15 at 1.2 s."""
    samples = np.zeros((120, 48))
    samples[:, :6] = [0.1, 0.2, 1.0, 0.3, 0.0, 3.0]
    samples[:, 0] += np.arange(120) / RATE_HZ
    phases = (
        Phase(0, 30, NOTHING),
        Phase(30, 60, GRASP),
        Phase(60, 72, SAFE_SLIP),
        Phase(72, 90, RISKY_SLIP),
    )
    return Recording(
        f"{person}/pinch",
        person,
        samples,
        np.ones((120, 16), np.bool_),
        RATE_HZ,
        "N",
        phases=phases,
        events=(RiskyEvent(1.0, 1.2, 1.5),),
        person=person,
    )


def test_two_pads_feel_the_whole_pad_and_its_opposite_at_the_time_of_the_files() -> (
    None
):
    felt = on_two_pads(pinched(), 150.0)
    # up to the last labelled row, at 89 / 60 s
    assert felt.samples.shape == (223, 6)
    for row in (0, 75, 222):
        ours = [0.4 + row / 150.0, 0.2, 4.0]
        assert felt.samples[row, :3] == pytest.approx(ours)
        assert felt.samples[row, 3:] == pytest.approx([-ours[0], -ours[1], 4.0])
    assert [(one.first, one.stop) for one in felt.phases][:3] == [
        (0, 75),
        (75, 150),
        (150, 180),
    ]


def test_an_alarm_is_false_only_while_the_object_is_held_and_has_not_turned() -> None:
    felt = on_two_pads(pinched(), 150.0)
    requests = np.zeros(len(felt.samples), np.bool_)
    requests[[20, 100, 160]] = True
    match = match_alarms(felt, requests)
    assert match.false_s == (100 / 150,)
    assert match.minutes == pytest.approx(0.5 / 60)
    assert match.outcomes[0].alarm_s == 160 / 150


def test_a_lost_reading_of_a_taxel_is_a_lost_reading_of_both_pads() -> None:
    recording = pinched()
    samples = recording.samples.copy()
    samples[60, 7] = np.nan
    felt = on_two_pads(replace(recording, samples=samples), 150.0)
    assert not felt.valid[150].any()
    assert felt.valid[[140, 160]].all()


def answered(person: str, found: bool) -> EventMatch:
    felt = on_two_pads(pinched(person), 150.0)
    requests = np.zeros(len(felt.samples), np.bool_)
    requests[160] = found
    return match_alarms(felt, requests)


def test_the_difference_is_paired_and_its_interval_draws_people() -> None:
    people = "abcdef"
    alone = [answered(one, one in "abc") for one in people]
    lifts = [answered(one, one in "bcd") for one in reversed(people)]
    row = compared(lifts, alone, seed=0)
    assert row["change"] == 0.0
    low, high = row["change_ci"]
    assert low < 0.0 < high
    assert row["recall_by_person"]["a"] == {"with_lifts": 0.0, "scenes_alone": 1.0}
    # found for the same people: no draw of people can tell them apart
    same = compared([answered(one, one in "abc") for one in people], alone, seed=0)
    assert same["change_ci"] == (0.0, 0.0)
