"""Data sets by name or folder, and several joined."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.core.contract import GRASP, RISKY_SLIP
from holdfast.core.errors import (
    ChannelError,
    DataError,
    DataNotFound,
    LabelError,
    RateError,
    UnitError,
)
from holdfast.data import datasets
from holdfast.data.datasets import load
from holdfast.data.datasets.joining import join
from holdfast.data.recording import DataSet
from holdfast.edge_runtime.preparation import Preparation


def write_eflesh(root: Path) -> Path:
    """Every second trial is tugged from row 150 on."""
    tugged = np.arange(20) % 2
    field = np.random.default_rng(1).standard_normal((20, 300, 30)) + 500.0
    field[tugged == 1, 150:] += 400.0
    np.savez(
        root / "eflesh_slip.npz", X=field.astype(np.float32), y=tugged.astype(np.int8)
    )
    return root


def test_a_set_is_found_by_name_in_the_data_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOLDFAST_DATA", str(tmp_path))
    (tmp_path / "eflesh_slip").mkdir()
    write_eflesh(tmp_path / "eflesh_slip")
    assert load("eflesh_slip").name == "eflesh_slip"


def test_a_format_is_recognised_whatever_the_folder_is_called(tmp_path: Path) -> None:
    other_name = tmp_path / "human_slip_uskin"
    other_name.mkdir()
    assert load(write_eflesh(other_name)).name == "eflesh_slip"


def test_a_set_that_is_not_there_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOLDFAST_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(
        DataNotFound,
        match=r"eflesh_slip not found; next: set HOLDFAST_DATA to .* eflesh_slip/",
    ):
        load("eflesh_slip")
    with pytest.raises(DataNotFound, match="no such data set or folder"):
        load("eflesh_slop")
    with pytest.raises(DataNotFound, match="no known data set in this folder"):
        load(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(DataNotFound, match="a file, not a folder"):
        load(tmp_path / "file")


def test_channels_a_set_does_not_have_are_refused(tmp_path: Path) -> None:
    write_eflesh(tmp_path)
    assert load(tmp_path, channels=30).n_sensors == 10
    with pytest.raises(ChannelError, match="recordings of 18 or 30 channels, not 48"):
        load(tmp_path, channels=48)


def test_an_eflesh_trial_is_held_or_tugged(tmp_path: Path) -> None:
    data = load(write_eflesh(tmp_path))
    rows = data.tasks["situations"]
    held = rows.take(rows.trial == 0)
    assert set(held.row) == set(range(205, 300, 6))
    assert set(held.label) == {GRASP}
    assert set(rows.label[rows.trial == 1]) == {RISKY_SLIP}
    blocks = [recording.group for recording in data.recordings[5:7]]
    assert blocks == ["block_00", "block_01"]
    assert data.unit == "uT"


NEW_READER = """
from dataclasses import replace

import numpy as np

from holdfast.core.contract import GRASP, NOTHING, averaged_by
from holdfast.data.datasets.public_files import PublicSet
from holdfast.data.datasets.thesis import SetMeta
from holdfast.data.recording import Recording, finite_sensors
from holdfast.data.timeline import Phase
from holdfast.data.windows import TimedTrial
from holdfast.edge_runtime.preparation import Preparation


def is_ours(root):
    return (root / "jar.npz").is_file()


def about(root):
    meta = SetMeta(name="jar_lids", kind="recorded by others")
    return PublicSet(meta, (6,), Preparation(), licence="CC0-1.0")


def trials(root, rate_hz):
    every = averaged_by(300.0, rate_hz or 150.0) or 2
    found = []
    for k, forces in enumerate(np.load(root / "jar.npz")["forces"]):
        samples = forces[::every]
        half, stop = len(samples) // 2, len(samples)
        phases = (Phase(0, half, NOTHING), Phase(half, stop, GRASP))
        recording = Recording(
            f"turn_{k}", f"turn_{k}", samples, finite_sensors(samples), 300 / every, "N",
            object_name="jar", action="lift", phases=phases, person=f"p{k % 2}",
        )
        found.append(TimedTrial(recording, None, timed=True, labels_by="keys"))
    return found
"""


def test_a_reader_is_one_module_and_its_set_is_had_like_any_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module is put into the package for this test, as a newcomer would."""
    package, root = tmp_path / "package", tmp_path / "set"
    package.mkdir()
    root.mkdir()
    (package / "jar_lids.py").write_text(NEW_READER)
    forces = np.random.default_rng(0).normal(2.0, 0.5, (4, 1800, 6))
    np.savez(root / "jar.npz", forces=forces)
    monkeypatch.setattr(datasets, "__path__", [*datasets.__path__, str(package)])
    name = f"{datasets.__name__}.jar_lids"
    try:
        assert "jar_lids" in datasets.public_sets()
        data = load(root)
        assert (data.name, data.rate_hz, data.n_sensors) == ("jar_lids", 150.0, 2)
        assert (data.licence, data.groups()) == ("CC0-1.0", ["p0", "p1"])
        assert data.tasks["situations"].label.any()
        assert load(root, rate_hz=50.0).rate_hz == 50.0
        assert not load(root, windows="none").tasks
        assert len(load(root, hold_out="trial").groups()) == 4
        assert "windows_natural" in load(root, windows="thesis", seed=1).notes
        with pytest.raises(ChannelError, match="of 6 channels, not 18"):
            load(root, channels=18)
        with pytest.raises(RateError, match="jar_lids is at 150 Hz, and cannot be"):
            load(root, rate_hz=1000.0)
    finally:
        sys.modules.pop(name, None)


def test_a_set_with_a_rate_of_its_own_refuses_another(tmp_path: Path) -> None:
    write_eflesh(tmp_path)
    assert load(tmp_path, rate_hz=101.0).rate_hz == 100.0
    with pytest.raises(RateError, match="eflesh_slip is at 100 Hz, and cannot be"):
        load(tmp_path, rate_hz=50.0)


def test_joined_sets_keep_every_recording_and_window_apart_by_name(
    fixture_folder: Path,
) -> None:
    one = load(fixture_folder)
    other = replace(one, name="other", redistributable=False, kind="recorded")
    both = join([one, other])
    names = [recording.trial_id for recording in one.recordings]
    expected = [f"{one.name}/{name}" for name in names]
    expected += [f"other/{name}" for name in names]
    assert [recording.trial_id for recording in both.recordings] == expected
    assert len(both.groups()) == 2 * len(one.groups())
    task, joined = one.tasks["classes"], both.tasks["classes"]
    assert joined.trial.tolist() == [*task.trial, *task.trial + len(names)]
    assert joined.label.tolist() == [*task.label, *task.label]
    assert (both.redistributable, both.kind) == (False, f"{one.kind} + recorded")


def test_one_set_joined_is_itself_and_the_same_twice_is_refused(
    fixture_folder: Path,
) -> None:
    one = load(fixture_folder)
    assert join([one]) is one
    with pytest.raises(DataError, match="the same set twice"):
        join([one, one])


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        (lambda data: replace(data, rate_hz=3.0 * data.rate_hz), RateError, "Hz"),
        (lambda data: replace(data, unit="uT"), UnitError, "unit: uT, not N"),
        (lambda data: replace(data, tasks={}), LabelError, "classes"),
        (
            lambda data: replace(data, preparation=Preparation()),
            DataError,
            "preparation",
        ),
    ],
)
def test_sets_that_one_model_cannot_serve_are_not_joined(
    fixture_folder: Path,
    change: Callable[[DataSet], DataSet],
    error: type[DataError],
    says: str,
) -> None:
    one = load(fixture_folder)
    with pytest.raises(error, match=says):
        join([one, replace(change(one), name="other")])
