"""Disturbed copies: the recording stays, its copies are of the same group, seed and phases."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from holdfast.core.contract import CLASSES, GRASP
from holdfast.core.hand_card import read_hand_card
from holdfast.data.recording import DataSet, LabelledRows, Recording
from holdfast.data.timeline import Phase
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training import nuisances
from holdfast.training.nuisances import disturbed, with_copies

RATE_HZ = 150.0
THUMB = np.array([True, True, False, False, False, False])


def a_recording(name: str = "one", length: int = 400) -> Recording:
    rng = np.random.default_rng(3)
    samples = 2.0 + 0.01 * rng.normal(size=(length, 18))
    return Recording(
        trial_id=name,
        group=name,
        samples=samples,
        valid=np.ones((length, 6), np.bool_),
        rate_hz=RATE_HZ,
        unit="N",
        phases=(Phase(0, length, GRASP),),
    )


def a_set() -> DataSet:
    rows = LabelledRows(
        np.array([0, 1]), np.array([200, 300]), np.array([2, 3]), CLASSES
    )
    return DataSet(
        name="set",
        recordings=[a_recording("one"), a_recording("two")],
        tasks={"classes": rows},
        rate_hz=RATE_HZ,
        unit="N",
        preparation=Preparation(),
        kind="simulated",
        redistributable=True,
        caveat="",
    )


def only(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    chances = dict.fromkeys(nuisances.CHANCE, 0.0)
    monkeypatch.setattr(nuisances, "CHANCE", {**chances, name: 1.0})


def test_a_copy_is_in_the_group_of_its_recording_so_no_split_parts_them() -> None:
    more = with_copies(a_set(), 2, seed=1)
    assert more.groups() == ["one", "two"]


def test_every_window_of_a_recording_is_a_window_of_its_copies() -> None:
    data = a_set()
    rows = with_copies(data, 1, seed=1).tasks["classes"]
    for trial, row, label in ((2, 200, 2), (3, 300, 3)):
        here = (rows.trial == trial) & (rows.row == row)
        assert rows.label[here].tolist()[0] == label


def test_windows_around_a_jump_have_the_label_of_their_phase_and_weight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    only(monkeypatch, "offset")
    rows = with_copies(a_set(), 1, seed=1).tasks["classes"]
    added = rows.take(rows.trial >= 2)
    assert len(added) > 4
    # a grasp of a light object in the first trial, of a heavy one in the second
    assert set(added.label[added.trial == 2].tolist()) == {2}
    assert set(added.label[added.trial == 3].tolist()) == {3}


@pytest.mark.parametrize("name", nuisances.CHANCE)
def test_each_nuisance_changes_readings_or_validity(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    only(monkeypatch, name)
    recording = a_recording()
    made = disturbed(recording, THUMB, np.random.default_rng(5)).recording
    same_values = np.array_equal(made.samples, recording.samples)
    same_valid = np.array_equal(made.valid, recording.valid)
    assert not (same_values and same_valid)
    assert np.isfinite(made.samples).all()


def test_without_any_nuisance_a_copy_is_the_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(nuisances, "CHANCE", dict.fromkeys(nuisances.CHANCE, 0.0))
    recording = a_recording()
    made = disturbed(recording, THUMB, np.random.default_rng(5))
    np.testing.assert_allclose(made.recording.samples, recording.samples, atol=1e-15)
    assert made.jumps == ()


def test_nothing_is_put_on_an_axis_that_the_hand_does_not_measure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(nuisances, "CHANCE", dict.fromkeys(nuisances.CHANCE, 1.0))
    usual = read_hand_card("six-fingertips")
    yz = tuple(msgspec.structs.replace(one, measures="yz") for one in usual.contacts)
    data = replace(a_set(), hand=replace(usual, contacts=yz))
    for seed in range(4):
        made = with_copies(data, 1, seed).recordings[2:]
        whole = with_copies(a_set(), 1, seed).recordings[2:]
        for one, other in zip(made, whole, strict=True):
            assert not one.samples[:, 0::3].any()
            # all else is struck as it was
            assert np.array_equal(one.samples[:, 1::3], other.samples[:, 1::3])
            assert np.array_equal(one.samples[:, 2::3], other.samples[:, 2::3])


def test_fewer_sensors_leave_one_on_each_side(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, "fewer sensors")
    for seed in range(20):
        made = disturbed(a_recording(), THUMB, np.random.default_rng(seed)).recording
        there = np.logical_and.reduce(made.valid, axis=0)
        assert there[THUMB].any()
        assert there[~THUMB].any()
