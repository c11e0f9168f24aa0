"""Measures of a lift's forces are those that it was made with, and learners see what differs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, FloatArray
from holdfast.core.hand_card import read_hand_card
from holdfast.data.recording import DataSet, Recording
from holdfast.data.timeline import Phase
from holdfast.edge_runtime.preparation import Preparation
from studies.people.lifts_and_scenes import (
    ContactForces,
    contacts_of,
    force_rows,
    forces_of,
    pooled_names,
    told_apart,
)

RATE_HZ = 150.0
FIRST, STOP = 150, 450
"""Rows of the contact: two seconds."""


def lift(
    person: str = "p1",
    tremor_n: float = 0.0,
    grip_s: float = 0.0,
    seed: int = 0,
    hold: float = 1.0,
) -> Recording:
    """Grip comes in 0.2 s, load 0.1 s later, load goes 0.2 s before the grip at grip_s = 0.

    4 N of grip and 2 N of load a pad, times hold; noise of 5 mN.
    """
    t_s = np.arange(600) / RATE_HZ

    def there(up_s: float, down_s: float) -> FloatArray:
        """Ramps of 0.2 s around two times after the contact."""
        since = t_s - FIRST / RATE_HZ
        rising = np.clip((since - up_s) / 0.2 + 0.5, 0.0, 1.0)
        falling = np.clip((since - down_s) / 0.2 + 0.5, 0.0, 1.0)
        return np.asarray(rising - falling)

    pads = np.zeros((600, 2, 3))
    load = 2.0 * there(0.3, 1.6) + 0.5 * tremor_n * np.sin(2 * np.pi * 6.7 * t_s)
    pads[:, :, 1] = hold * load[:, None] * [1.0, -1.0]
    pads[:, :, 2] = hold * 4.0 * there(0.2, 1.8 - grip_s)[:, None]
    noise = np.random.default_rng(seed).normal(0.0, 0.005, (600, 2, 2))
    pads[:, :, 1:] += noise
    return Recording(
        f"{person}/{seed}",
        person,
        pads.reshape(600, 6),
        np.ones((600, 2), dtype=np.bool_),
        RATE_HZ,
        "N",
        action="lift",
        phases=(
            Phase(0, FIRST, NOTHING),
            Phase(FIRST, STOP, GRASP),
            Phase(STOP, 600, NOTHING),
        ),
        person=person,
    )


def measured(recording: Recording) -> ContactForces:
    ((first, grasped, stop),) = contacts_of(recording)
    forces = forces_of(recording, first, grasped, stop)
    assert forces is not None
    return forces


def data_of(name: str, recordings: list[Recording]) -> DataSet:
    hand = read_hand_card("two-transducers")
    return DataSet(
        name, recordings, {}, RATE_HZ, "N", Preparation(), "made", True, "", hand=hand
    )


def test_the_measures_of_a_lift_are_those_it_was_made_with() -> None:
    forces = measured(lift())
    assert forces.duration_s == pytest.approx(2.0)
    assert forces.grip_n == pytest.approx(4.0, abs=0.01)
    assert forces.load_n == pytest.approx(4.0, abs=0.02)
    assert forces.grip_over_load == pytest.approx(1.0, abs=0.01)
    # 4 N in 0.2 s
    assert forces.grip_up_n_s == pytest.approx(20.0, rel=0.1)
    assert forces.load_up_n_s == pytest.approx(20.0, rel=0.1)
    assert forces.grip_down_n_s == pytest.approx(20.0, rel=0.1)
    assert forces.load_down_n_s == pytest.approx(20.0, rel=0.1)
    assert forces.grip_after_load_up_ms == pytest.approx(-100.0, abs=10.0)
    assert forces.grip_after_load_down_ms == pytest.approx(200.0, abs=10.0)
    assert forces.tremor_mn < 10.0


def test_a_grip_that_falls_before_the_load_has_a_negative_time() -> None:
    assert measured(lift(grip_s=0.3)).grip_after_load_down_ms == pytest.approx(
        -100.0, abs=10.0
    )


def test_the_tremor_is_the_rms_of_the_load_in_its_band() -> None:
    # 0.1 N of amplitude on both pads together
    assert measured(lift(tremor_n=0.1)).tremor_mn == pytest.approx(71.0, rel=0.15)


def test_a_contact_that_slips_and_an_empty_hand_are_no_hold() -> None:
    whole = lift()
    slips = (*whole.phases[:2], Phase(STOP, 500, RISKY_SLIP), Phase(500, 600, NOTHING))
    assert not list(contacts_of(replace(whole, phases=slips)))
    assert not list(contacts_of(replace(whole, action="tap")))


def test_rows_are_of_each_person_of_all_of_each_scene_and_its_actions() -> None:
    people = data_of("lifts", [lift("p1"), lift("p2", hold=2.0), lift("p2", hold=2.0)])
    rows = force_rows(people, [data_of("scene", [lift("", hold=0.5)])])
    assert [(row.name, row.contacts) for row in rows] == [
        ("p1", 1),
        ("p2", 2),
        ("all people", 3),
        ("scene", 1),
        ("scene: lift", 1),
    ]
    assert rows[1].measures["grip_n"].median == pytest.approx(8.0, abs=0.02)
    assert rows[3].measures["grip_n"].median == pytest.approx(2.0, abs=0.02)


def test_a_learner_tells_a_trembling_scene_and_no_scene_that_is_alike() -> None:
    lifts = data_of("lifts", [lift(f"p{k}", seed=k) for k in range(15)])
    alike = [lift(f"t{k}", seed=100 + k) for k in range(15)]
    trembling = [lift(f"t{k}", tremor_n=0.4, seed=100 + k) for k in range(15)]

    same = told_apart(lifts, [data_of("scene", alike)])
    apart = told_apart(lifts, [data_of("scene", trembling)])
    assert same.auc < 0.75
    assert apart.auc > 0.99
    assert same.lift_windows == same.scene_windows == 45
    assert len(apart.strongest) == 5
    assert {name for name, _ in apart.strongest} <= set(pooled_names())
