"""The thesis' folders: what is recognised, how it is prepared, whom its labels believe, what is
refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from filecmp import cmpfiles
from pathlib import Path

import numpy as np
import pytest

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP, channel_names
from holdfast.core.errors import (
    ChannelError,
    DataError,
    DataNotFound,
    LabelError,
    RateError,
)
from holdfast.core.trial_file import Trial, read_trial
from holdfast.core.trial_layout import truth_path
from holdfast.data.datasets import layout_of, load, thesis
from holdfast.data.fixture import UPSIDE_DOWN, write_fixture
from holdfast.data.recording import DataSet
from holdfast.data.timeline import contact, read_truth, scripted

TWO_STEPS = [NOTHING, GRASP, SAFE_SLIP, GRASP, SAFE_SLIP, NOTHING]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    write_fixture(folder, trials_per_cell=2)
    return folder


@pytest.fixture
def copied(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "set")


@pytest.fixture(scope="module")
def data(made: Path) -> DataSet:
    return load(made, windows="thesis")


def test_the_layout_is_recognised_and_others_are_not(
    made: Path, tmp_path: Path
) -> None:
    assert layout_of(made) == "thesis"
    assert layout_of(tmp_path) is None
    assert layout_of(tmp_path / "nowhere") is None
    (tmp_path / "photos" / "summer").mkdir(parents=True)
    (tmp_path / "photos" / "summer" / "trial_1.csv").touch()
    assert layout_of(tmp_path) is None


def test_every_trial_and_the_empty_hand_become_recordings(data: DataSet) -> None:
    assert len(data.recordings) == 5 * 3 * 2 + 1
    of = {recording.trial_id: recording for recording in data.recordings}
    trial, empty = of["full-bottle/fall/trial_2"], of["nothing/trial_1"]
    assert (trial.object_name, trial.action) == ("full-bottle", "fall")
    assert trial.group == trial.trial_id
    assert (empty.object_name, empty.action) == (None, None)
    assert (data.rate_hz, data.unit, data.n_sensors) == (50.0, "N", 6)


def test_magnets_are_turned_round_and_the_offset_is_taken_off(
    made: Path, data: DataSet
) -> None:
    recording = data.recordings[0]
    raw = read_trial(made / f"{recording.trial_id}.csv").raw
    held = slice(round(4.5 * 50), round(6.5 * 50))
    for sensor in range(6):
        z = 3 * sensor + 2
        assert (raw[0, z] < 0) == (sensor in UPSIDE_DOWN)
        assert recording.samples[held, z].mean() > 0.3
    np.testing.assert_allclose(recording.samples[:5].mean(axis=0), 0.0, atol=1e-12)


def test_both_spellings_of_the_folders_are_read(copied: Path) -> None:
    (copied / "soft-ball").rename(copied / "softball")
    (copied / "full-bottle").rename(copied / "colabottle")
    (copied / "colabottle" / "put-down").rename(copied / "colabottle" / "putdown")
    objects = {recording.object_name for recording in load(copied).recordings}
    assert {"soft-ball", "full-bottle"} <= objects


def test_the_truth_beside_a_trial_is_believed_before_the_script(copied: Path) -> None:
    """The same trials with another truth beside one of them: other labels come out."""
    result = load(copied).notes["samples"]
    phases_of((0, 2, "nothing"))(copied)
    assert load(copied).notes["samples"] != result


@pytest.mark.parametrize(
    ("trial", "situations"),
    [
        ("soft-ball/pass", [NOTHING, GRASP, SAFE_SLIP, NOTHING]),
        ("soft-ball/pull", [NOTHING, GRASP, RISKY_SLIP, NOTHING]),
        ("soft-ball/put-down", TWO_STEPS),
        ("full-bottle/pass", TWO_STEPS),
    ],
)
def test_without_truth_the_labels_follow_the_script(
    made: Path, trial: str, situations: list[int]
) -> None:
    phases = follow(made / trial / "trial_1.csv")
    assert [phase.situation for phase in phases] == situations
    if situations == TWO_STEPS:
        assert [phase.first / 50.0 for phase in phases[2:5]] == [7.0, 9.0, 10.0]


def follow(path: Path) -> tuple:
    trial = read_trial(path)
    return scripted(
        trial,
        thesis.preparation("N").apply(trial.raw),
        path.parent.name,
        path.parent.parent.name,
    )


def test_contact_is_read_from_the_forces_close_to_where_the_truth_says(
    made: Path,
) -> None:
    for path in made.glob("*/p*/trial_*.csv"):
        trial = read_trial(path)
        truth = read_truth(truth_path(path)).phases_on(trial.t_s, path)
        onset, empty = contact(trial.t_s, thesis.preparation("N").apply(trial.raw))
        assert abs(onset - truth[1].first) < 0.4 * 50
        assert abs(empty - truth[-1].first) < 0.4 * 50


def test_a_trial_that_does_not_follow_the_script_is_refused(made: Path) -> None:
    trial = read_trial(made / "soft-ball/pass/trial_1.csv")
    shifted = Trial(trial.path, trial.t_s, np.roll(trial.raw, 400, axis=0), trial.valid)
    with pytest.raises(LabelError, match=r"trial_1\.csv"):
        scripted(
            shifted, thesis.preparation("N").apply(shifted.raw), "pass", "soft-ball"
        )


@pytest.mark.parametrize("action", ["regrip", "daily"])
def test_an_everyday_action_and_a_daily_stream_live_by_their_truth_alone(
    copied: Path, action: str
) -> None:
    trial = f"soft-ball/{action}/trial_1"
    renamed("soft-ball/pass", f"soft-ball/{action}")(copied)
    recordings = load(copied, windows="natural").recordings
    assert (trial, action) in [(one.trial_id, one.action) for one in recordings]
    (copied / f"{trial}.truth.json").unlink()
    with pytest.raises(
        LabelError, match=rf"{trial}\.csv.*put trial_1\.truth\.json beside it"
    ):
        load(copied, windows="natural")


def retime(path: Path, clock: Callable[[np.ndarray], np.ndarray]) -> None:
    trial = read_trial(path)
    write_trial(path, clock(trial.t_s), trial.raw)


def write_trial(path: Path, t_s: np.ndarray, raw: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = ",".join(["Time", *channel_names(raw.shape[1] // 3)])
    np.savetxt(
        path,
        np.column_stack([t_s, raw]),
        delimiter=",",
        header=header,
        comments="",
        fmt="%.6f",
    )


TRIAL = "hard-ball/pass/trial_1.csv"


TRUTH = "hard-ball/pass/trial_1.truth.json"
Change = Callable[[Path], object]


def written(name: str, text: str) -> Change:
    return lambda root: (root / name).write_text(text)


def phases_of(*phases: tuple[float, float, str]) -> Change:
    entries = [{"t0_s": t0, "t1_s": t1, "label": label} for t0, t1, label in phases]
    return written(TRUTH, json.dumps({"phases": entries}))


def renamed(name: str, new: str) -> Change:
    return lambda root: (root / name).rename(root / new)


def with_a_trial_of_fewer_sensors(root: Path) -> None:
    trial = read_trial(root / TRIAL)
    write_trial(root / TRIAL, trial.t_s, trial.raw[:, :15])


@pytest.mark.parametrize(
    ("spoil", "error", "names"),
    [
        (renamed("hard-ball/pass", "hard-ball/juggle"), LabelError, "juggle"),
        (written("meta.json", '{"unit": "lbf"}'), LabelError, "lbf"),
        (
            lambda root: retime(root / TRIAL, lambda t_s: t_s * 1.2),
            RateError,
            "hard-ball/pass/trial_1",
        ),
        (with_a_trial_of_fewer_sensors, ChannelError, "hard-ball/pass/trial_1"),
        (phases_of((0, 9, "grasp"), (5, 9, "nothing")), LabelError, "trial_1.truth"),
        (shutil.rmtree, DataNotFound, "no such data set or folder"),
    ],
)
def test_a_set_is_refused_in_one_line_that_names_the_fault(
    copied: Path, spoil: Change, error: type[DataError], names: str
) -> None:
    spoil(copied)
    with pytest.raises(error) as caught:
        load(copied, windows="thesis")
    assert type(caught.value) is error
    assert names in str(caught.value)
    assert "\n" not in str(caught.value)


def test_lost_values_in_a_trial_are_marked_and_do_not_stop_it(copied: Path) -> None:
    trial = read_trial(copied / TRIAL)
    trial.raw[100:103, 4] = np.nan
    write_trial(copied / TRIAL, trial.t_s, trial.raw)
    of = {f"{one.trial_id}.csv": one for one in load(copied).recordings}
    lost = np.argwhere(~of[TRIAL].valid)
    assert lost.tolist() == [[100, 1], [101, 1], [102, 1]]


def test_the_fixture_writes_the_same_bytes_for_the_same_seed(
    made: Path, tmp_path: Path
) -> None:
    write_fixture(tmp_path / "same", trials_per_cell=2)
    write_fixture(tmp_path / "other", trials_per_cell=2, seed=1)
    paths = sorted(path.relative_to(made) for path in made.rglob("*.*"))
    assert len(paths) == 2 * 30 + 2
    match, _, _ = cmpfiles(made, tmp_path / "same", paths, shallow=False)
    assert match == paths
    _, differ, _ = cmpfiles(made, tmp_path / "other", [TRIAL], shallow=False)
    assert differ == [TRIAL]
