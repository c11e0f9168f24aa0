"""Recordings from pandas are those that a folder of the same trials gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from own_data import write_meta, write_people_folders

from holdfast import training
from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP
from holdfast.core.errors import (
    ColumnError,
    DataError,
    LabelError,
    NotANumber,
)
from holdfast.core.trial_layout import truth_path
from holdfast.training.datasets import load
from holdfast.training.recording import Recording

PULL = "p01/soft-ball/pull/trial_1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people without any truth, the action at 6.9 s; the trials of three cells."""
    root = write_people_folders(tmp_path_factory.mktemp("frames"))
    kept = ("soft-ball/pull", "hard-ball/pass", "nothing")
    for path in root.glob("p*/**/trial_1.csv"):
        truth_path(path).unlink(missing_ok=True)
        if path.parent.relative_to(root).as_posix().partition("/")[2] not in kept:
            path.unlink()
    write_meta(root, unit="N", action_at_s=6.9)
    return root


@pytest.fixture(scope="module")
def frames(folder: Path) -> dict[str, pd.DataFrame]:
    paths = sorted(folder.rglob("trial_1.csv"))
    return {
        path.relative_to(folder).with_suffix("").as_posix(): pd.read_csv(path)
        for path in paths
    }


def test_frames_are_read_as_the_folder_of_the_same_trials(
    folder: Path, frames: dict[str, pd.DataFrame]
) -> None:
    before = {key: frame.copy() for key, frame in frames.items()}
    data = training.recordings_from_frames(frames, action_at_s=6.9, windows="natural")
    other = load(folder, windows="natural")
    assert data.groups() == ["p01", "p02"]
    assert (data.group_kind, data.rate_hz) == ("person", 50.0)
    of_folder = {one.trial_id: one for one in other.recordings}
    assert len(of_folder) == len(data.recordings)
    for one in data.recordings:
        same = of_folder[one.trial_id]
        np.testing.assert_array_equal(one.samples, same.samples)
        np.testing.assert_array_equal(one.valid, same.valid)
        assert (one.phases, one.events) == (same.phases, same.events)
        assert (one.person, one.object_name) == (same.person, same.object_name)
        assert one.action == same.action
    assert data.notes["windows"] == other.notes["windows"]
    assert all(frame.equals(before[key]) for key, frame in frames.items())


def labelled(frame: pd.DataFrame) -> pd.DataFrame:
    """Nothing to 3 s, grasp to 7 s, risky to 7.5 s, no label after."""
    edges = [3.0, 7.0, 7.5]
    names = np.array(["nothing", "grasp", "risky_slip", None], dtype=object)
    return frame.assign(
        label=names[np.searchsorted(edges, frame["Time"], side="right")]
    )


def recording_of(frame: pd.DataFrame) -> Recording:
    data = training.recordings_from_frames({PULL: frame}, windows="natural")
    return data.recordings[0]


def phases_of(recording: Recording) -> list[tuple[float, float, int]]:
    return [(one.first / 50, one.stop / 50, one.situation) for one in recording.phases]


def test_a_column_of_labels_is_believed_before_the_script(
    frames: dict[str, pd.DataFrame],
) -> None:
    recording = recording_of(labelled(frames[PULL]))
    expected = [(0.0, 3.0, NOTHING), (3.0, 7.0, GRASP), (7.0, 7.5, RISKY_SLIP)]
    assert phases_of(recording) == expected
    event = recording.events[0]
    assert (event.onset_s, event.end_s) == (7.0, 7.5)


def test_the_last_row_is_of_the_last_label(frames: dict[str, pd.DataFrame]) -> None:
    held = recording_of(labelled(frames[PULL]).fillna({"label": "nothing"}))
    assert held.phases[-1].stop == len(held.samples)


def test_labels_stay_at_their_time_where_rows_were_lost(
    frames: dict[str, pd.DataFrame],
) -> None:
    with_gap = labelled(frames[PULL]).drop(index=[100, 101])
    assert phases_of(recording_of(with_gap))[1:] == [
        (3.0, 7.0, GRASP),
        (7.0, 7.5, RISKY_SLIP),
    ]


@pytest.mark.parametrize(
    ("spoil", "error", "says"),
    [
        (
            lambda frame: frame.drop(columns="Time"),
            ColumnError,
            "columns missing: Time",
        ),
        (lambda frame: frame.assign(X1="far"), NotANumber, PULL),
        (lambda frame: frame.assign(label="hovering"), LabelError, "'hovering'"),
    ],
)
def test_a_frame_that_cannot_be_used_is_refused_by_its_name(
    frames: dict[str, pd.DataFrame], spoil, error: type[DataError], says: str
) -> None:
    with pytest.raises(error) as caught:
        training.recordings_from_frames({PULL: spoil(frames[PULL])}, windows="natural")
    assert says in str(caught.value)
