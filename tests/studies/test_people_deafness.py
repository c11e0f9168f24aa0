"""Slips put into lifts change the hold from their onset on, and nothing before it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP
from holdfast.core.errors import RateError
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase
from holdfast.evaluation.alarms import match_alarms
from studies.people.deafness import SimulatedSlip, simulated_slips, with_slips
from studies.people.two_pads import write_two_pad_scene

RATE_HZ = 150.0
CONTACTS = ((150, 300), (450, 600))
"""Rows of two lifts of a second each."""


def lifts() -> Recording:
    """4 N a pad that bear 2 N; the second pad's load has the other sign. Loads come in 0.2 s."""
    samples = np.zeros((700, 2, 3))
    phases = []
    last = 0
    for contact, release in CONTACTS:
        held = np.interp(
            np.arange(release - contact), [0, 30, 120, 150], [0.0, 1.0, 1.0, 0.1]
        )
        samples[contact:release, :, 1] = held[:, None] * [2.0, -2.0]
        samples[contact:release, :, 2] = held[:, None] * [4.0, 4.0]
        phases += [Phase(last, contact, NOTHING), Phase(contact, release, GRASP)]
        last = release
    flat = samples.reshape(len(samples), 6)
    valid = np.ones((700, 2), dtype=np.bool_)
    return Recording(
        "p1/file", "p1", flat, valid, RATE_HZ, "N", phases=tuple(phases), person="p1"
    )


def slip(rows: int = 16) -> SimulatedSlip:
    """Loads of 3 N more on a hold of 1 N a pad, while the first pad loses half of 2 N."""
    share = np.linspace(0.0, 1.0, rows)
    return SimulatedSlip(
        "made",
        RATE_HZ,
        share[:, None] * [3.0, 3.0],
        share[:, None] * [-1.0, 0.0],
        8.0,
        onset_s=0.4 / RATE_HZ,
        gross_s=(rows - 1) / RATE_HZ,
        end_s=(rows + 5) / RATE_HZ,
    )


def put(size: float = 1.0, seed: int = 100) -> tuple[Recording, Recording]:
    whole = lifts()
    return whole, with_slips(whole, [slip()], np.random.default_rng(seed), size)


def test_a_slip_of_no_size_changes_no_sample() -> None:
    whole, same = put(size=0.0)
    assert len(same.events) == 2
    assert np.array_equal(same.samples, whole.samples)


def test_every_lift_gets_one_slip_and_is_as_it_was_before_the_onset() -> None:
    whole, slipping = put()
    changed = np.any(slipping.samples != whole.samples, axis=1)
    assert len(slipping.events) == 2
    for event, (contact, release) in zip(slipping.events, CONTACTS, strict=True):
        first = contact + int(np.flatnonzero(changed[contact:release])[0])
        assert first == int(np.ceil(event.onset_s * RATE_HZ))
        assert 0.3 * 150 < first - contact < 0.6 * 150
        assert event.gross_s is not None
        assert event.gross_s - event.onset_s == pytest.approx(14.6 / RATE_HZ)
        changed[contact:release] = False
    assert not changed.any()


def test_at_gross_slip_the_change_has_the_size_of_the_lifts_own_load() -> None:
    whole, slipping = put()
    change = (slipping.samples - whole.samples).reshape(-1, 2, 3)
    for event in slipping.events:
        assert event.gross_s is not None
        gross = round(event.gross_s * RATE_HZ)
        # 8 N at gross slip, 4 N in the lift: half of 3 N, along the load of each pad
        assert change[gross, :, 1] == pytest.approx([1.5, -1.5])
        assert change[gross, :, 2] == pytest.approx([-0.5, 0.0])
        assert not change[..., 0].any()


def test_a_pad_never_pulls_at_what_it_touches() -> None:
    whole = lifts()
    strong = replace(slip(), normal_n=40.0 * slip().normal_n)
    slipping = with_slips(whole, [strong], np.random.default_rng(100))
    assert slipping.samples.reshape(-1, 2, 3)[..., 2].min() == 0.0


def test_the_same_seed_makes_the_same_slips_and_another_seed_others() -> None:
    assert np.array_equal(put(seed=100)[1].samples, put(seed=100)[1].samples)
    assert not np.array_equal(put(seed=100)[1].samples, put(seed=101)[1].samples)


def test_an_alarm_in_the_slip_finds_it_and_what_follows_it_counts_in_no_figure() -> (
    None
):
    _, slipping = put()
    requests = np.zeros(len(slipping.samples), dtype=np.bool_)
    for event in slipping.events:
        first = int(np.ceil(event.onset_s * RATE_HZ)) + 3
        requests[first : first + 5] = True
        end = int(np.ceil(event.end_s * RATE_HZ))
        requests[end + 5 : end + 8] = True
    match = match_alarms(slipping, requests)
    assert all(one.alarm_s is not None for one in match.outcomes)
    assert all(0.019 < (one.delay_s or 0.0) < 0.028 for one in match.outcomes)
    assert match.false_s == ()
    situations = {phase.situation for phase in slipping.phases}
    assert RISKY_SLIP in situations


def test_a_lift_without_room_or_load_and_a_broken_one_get_no_slip() -> None:
    whole = lifts()
    rng = np.random.default_rng(100)
    assert not with_slips(whole, [slip(rows=150)], rng).events
    assert not with_slips(
        replace(whole, samples=0.0 * whole.samples), [slip()], rng
    ).events
    first_alone = replace(whole, phases=whole.phases[:2])
    assert len(with_slips(first_alone, [slip()], rng).events) == 1


def test_slips_of_another_rate_are_refused() -> None:
    with pytest.raises(RateError, match="150 Hz in a recording at 50 Hz"):
        with_slips(replace(lifts(), rate_hz=50.0), [slip()], np.random.default_rng(0))


def test_slips_of_a_scene_begin_with_nothing_and_end_at_gross_slip(
    tmp_path: Path,
) -> None:
    scene = write_two_pad_scene("thesis", RATE_HZ, tmp_path)
    slips = simulated_slips(scene, 100, 8)
    assert {one.name.split()[1] for one in slips} == {"pull", "fall"}
    for one in slips:
        assert not one.load_n[0].any()
        assert not one.normal_n[0].any()
        assert 0.0 <= one.onset_s <= 1.0 / RATE_HZ
        assert one.onset_s < one.gross_s <= one.end_s
        assert len(one.load_n) == len(one.normal_n)
        assert len(one.load_n) - 1 == int(np.ceil(one.gross_s * RATE_HZ - 1e-9))
        # a load that comes, or one against the hold's own
        assert np.abs(one.load_n[-1]).max() > 0.01
