"""The reader of grip_lift_ati: a made copy of its files, and the real one where it is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from holdfast.core.contract import GRASP, NOTHING
from holdfast.core.errors import ChannelError, RateError
from holdfast.core.locked import require_open_people
from holdfast.data.datasets import load
from holdfast.data.datasets.grip_lift_ati import NAME, RESTS
from holdfast.evaluation.alarms import match_alarms

REST = (-4.0, 1.5, 0.4, -1.7)
"""N, of a column at rest: yellow and orange normal force, yellow and orange load."""


def write_lifts(root: Path, *, broken: tuple[int, ...] = ()) -> Path:
    """One file of 12 s with three lifts of a second, 4 N pressed and 1 N lifted on each side."""
    forces = np.zeros((7200, 4))
    lines = []
    for number, at_s in enumerate((2.0, 5.0, 8.0)):
        rows = slice(round(600 * at_s), round(600 * (at_s + 1.0)))
        forces[rows] = [4.0, 4.0, 1.0, 1.0]
        line = {
            "person": "p1547",
            "file": "one",
            "object": "textureA1",
            "from_s": at_s - 0.5,
            "contact_s": at_s,
            "release_s": at_s + 1.0,
            "to_s": at_s + 1.4,
            "yellow_ok": number not in broken,
        }
        lines.append(line | dict(zip(RESTS, REST, strict=True)))
    np.savez(root / "p1547.npz", one=(forces + REST).astype(np.float32))
    pd.DataFrame(lines).to_csv(root / "lifts.csv", index=False)
    return root


def test_a_file_is_one_recording_without_its_rest_and_without_the_axis_that_was_not_measured(
    tmp_path: Path,
) -> None:
    data = load(write_lifts(tmp_path))
    (recording,) = data.recordings
    assert recording.samples.shape == (1800, 6)
    # a row is the mean of four, so edges are sharp only where a lift begins at such a row
    assert recording.samples[350] == pytest.approx([0, 1, 4, 0, 1, 4], abs=1e-5)
    assert recording.samples[10] == pytest.approx([0.0] * 6, abs=1e-5)
    assert data.hand is not None
    assert data.hand.unmeasured_names == ("X1", "X2")
    assert recording.events == ()


def test_each_lift_is_nothing_then_a_grasp_then_nothing(tmp_path: Path) -> None:
    (recording,) = load(write_lifts(tmp_path)).recordings
    found = [(one.first, one.stop, one.situation) for one in recording.phases[:3]]
    assert found == [(225, 300, NOTHING), (300, 450, GRASP), (450, 510, NOTHING)]


def test_a_lift_whose_sensor_is_broken_is_no_window_and_no_minute(
    tmp_path: Path,
) -> None:
    data = load(write_lifts(tmp_path, broken=(1,)), windows="dense")
    (recording,) = data.recordings
    # from 4.5 to 6.4 s
    assert recording.left_out == ((675, 960),)
    rows = data.tasks["situations"].row
    assert not np.any((rows >= 675) & (rows < 960))

    alarms = np.zeros(1800, np.bool_)
    alarms[[700, 1300]] = True
    match = match_alarms(recording, alarms)
    assert match.false_s == (1300 / 150,)
    assert match.minutes == pytest.approx((12.0 - 1.9) / 60.0)


def test_lifts_are_averaged_down_to_the_rate_of_a_model(tmp_path: Path) -> None:
    data = load(write_lifts(tmp_path), rate_hz=50.0)
    assert data.rate_hz == data.recordings[0].rate_hz == 50.0
    assert len(data.recordings[0].samples) == 600
    with pytest.raises(RateError, match="600 Hz is no whole multiple of 170 Hz"):
        load(tmp_path, rate_hz=170.0)


def test_a_model_of_another_hand_is_told_how_to_fit_it(tmp_path: Path) -> None:
    with pytest.raises(ChannelError, match=r"6 channels, not 18.*export MODEL --hand"):
        load(write_lifts(tmp_path), channels=18)


def test_the_ten_people_are_open_and_their_minutes_are_those_that_count(
    real_set: Callable[[str], Path],
) -> None:
    data = load(real_set(NAME), windows="none")
    require_open_people(NAME, data.people(), "a model")
    assert len(data.groups()) == 10
    assert len(data.recordings) == 140
    seconds = sum(one.counted_s(len(one.samples)) for one in data.recordings)
    assert seconds / 60.0 == pytest.approx(30.2, abs=0.05)
    lifts = [one for of in data.recordings for one in of.phases if one.situation]
    assert len(lifts) == 1017
