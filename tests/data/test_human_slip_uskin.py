"""human_slip_uskin: the labeller against a slow loop of its definition, the known counts, bad
folders."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.core.errors import ColumnError, NotANumber
from holdfast.data.datasets import load
from holdfast.data.datasets.human_slip_uskin import middle_angle_deg
from holdfast.data.recording import DataSet

Arrays = dict[str, Any]
Lines = list[dict[str, Any]]
LENGTHS = (320, 291, 400, 350)


def made_trial(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Tactile rows with a grasp from row 90, and an IMU that turns from row 150 on."""
    force = np.clip((np.arange(n) - 90) / 20.0, 0.0, 1.0)
    xela = (
        3.0
        + 0.02 * rng.standard_normal((n, 48))
        + force[:, None] * rng.uniform(0.0, 0.4, 48)
    )
    turn = np.radians(np.clip(np.arange(n) - 150.0, 0.0, 40.0) * rng.uniform(0.3, 0.8))
    imu = np.zeros((n, 7))
    imu[:, [0, 2]] = np.round(
        np.column_stack([np.cos(turn / 2.0 + 0.4), np.sin(turn / 2.0 + 0.4)]), 2
    )
    return xela, imu


def made_parts() -> tuple[Arrays, Lines]:
    rng = np.random.default_rng(7)
    trials = [made_trial(rng, n) for n in LENGTHS]
    offset = np.concatenate([[0], np.cumsum(LENGTHS)])
    arrays = {
        "xela": np.concatenate([xela for xela, _ in trials]).astype(np.float32),
        "object_imu": np.concatenate([imu for _, imu in trials]).astype(np.float32),
        "offset": offset,
    }
    lines: Lines = [
        {
            "subject": 1 + k // 2,
            "stage": "baseline",
            "sample": f"sample_{k}",
            "n": n,
            "offset": offset[k],
            "frequency_hz": 58.0 + k,
            "start_index": 150,
            "middle_index": 0,
            "end_index": 200 + 30 * k,
            "task_completion_time": 1.0,
        }
        for k, n in enumerate(LENGTHS)
    ]
    return arrays, lines


def write(root: Path, arrays: Arrays, lines: Lines) -> Path:
    np.savez(root / "signals.npz", **arrays)
    with (root / "trials.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(lines[0]))
        table.writeheader()
        table.writerows(lines)
    return root


def brute_force(
    xela: np.ndarray, imu: np.ndarray, s: int, t: int
) -> tuple[list[Any], list[Any]]:
    """The README's labeller, one row at a time, with scipy's own angles."""
    n, bias = len(xela), np.median(xela[:60].astype(np.float64), axis=0)
    with warnings.catch_warnings():
        # gimbal lock: the middle angle is right all the same
        warnings.simplefilter("ignore", UserWarning)
        turns = Rotation.from_quat(imu[:, :4], scalar_first=True)
        angle = turns.as_euler("xyx", degrees=True)[:, 1]
    z = (xela - bias)[:, 2::3].sum(axis=1)
    d = abs(angle - np.median(angle[max(0, s - 30) : s - 3]))
    situations, predictions = [], []
    for f in range(65, min(n, t + 60), 6):
        label = 0 if z[f] < 1 else 1 if d[f] < 5 else 2 if d[f] < 15 else 3
        situations.append((f, label))
    for f in range(max(60, s - 60) + 5, min(t, n), 3):
        ahead = d[f + 1 : f + 16]
        if z[f] >= 1 and d[f] < 5 and len(ahead):
            predictions.append((f, int(max(ahead) > 15)))
    return situations, predictions


def assert_equals_brute_force(data: DataSet, root: Path, trials: list[int]) -> None:
    arrays = np.load(root / "signals.npz", allow_pickle=False)
    xela, imu, offset = (arrays[name] for name in ("xela", "object_imu", "offset"))
    with (root / "trials.csv").open() as file:
        lines = list(csv.DictReader(file))
    for k in trials:
        rows = slice(offset[k], offset[k + 1])
        s, t = int(lines[k]["start_index"]), int(lines[k]["end_index"])
        expected = brute_force(xela[rows], imu[rows], s, t)
        for task, pairs in zip(("situations", "predict_250ms"), expected, strict=True):
            here = data.tasks[task].take(data.tasks[task].trial == k)
            assert (
                list(zip(here.row.tolist(), here.label.tolist(), strict=True)) == pairs
            )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path, *made_parts())


def test_the_labeller_equals_a_loop_over_its_definition(folder: Path) -> None:
    data = load(folder)
    assert_equals_brute_force(data, folder, [0, 1, 2, 3])
    assert set(data.tasks["situations"].label) == {0, 1, 2, 3}
    assert set(data.tasks["predict_250ms"].label) == {0, 1}


def test_the_closed_angle_equals_scipys_for_any_quaternion() -> None:
    q = np.random.default_rng(0).standard_normal((1000, 4))
    expected = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_euler("xyx", degrees=True)[
        :, 1
    ]
    np.testing.assert_allclose(middle_angle_deg(q), expected, atol=1e-10)


def test_channels_change_the_samples_and_never_the_labels(folder: Path) -> None:
    six, all_taxels = load(folder), load(folder, channels=48)
    assert (six.n_sensors, all_taxels.n_sensors) == (6, 16)
    for task, rows in six.tasks.items():
        np.testing.assert_array_equal(rows.label, all_taxels.tasks[task].label)
    few, many = six.recordings[1].samples, all_taxels.recordings[1].samples
    # txl2 is the second taxel: channels 3, 4, 5; txl16 comes last.
    np.testing.assert_array_equal(few[:, :3], many[:, 3:6])
    np.testing.assert_array_equal(few[:, 15:], many[:, 45:48])


def test_unusable_trials_are_left_out_and_counted(tmp_path: Path) -> None:
    arrays, lines = made_parts()
    lines[0]["start_index"], lines[1]["end_index"] = 60, 292
    data = load(write(tmp_path, arrays, lines))
    assert (len(data.recordings), data.notes["unusable_trials"]) == (2, 2)


def test_rows_that_are_not_finite_are_invalid_and_unlabelled(tmp_path: Path) -> None:
    arrays, lines = made_parts()
    # a row that ends a window; txl2 is the first of the six
    arrays["xela"][131, 3] = np.nan
    # normals that count for contact, but not of the six
    arrays["xela"][137, [2, 8]] = np.inf, -np.inf
    arrays["object_imu"][143, :4] = 0.0
    data = load(write(tmp_path, arrays, lines))
    first = data.recordings[0]
    assert not first.valid[131, 0]
    assert first.valid[131, 1:].all()
    assert first.valid[137].all()
    rows = data.tasks["situations"].row[data.tasks["situations"].trial == 0]
    assert {137, 143}.isdisjoint(rows.tolist())
    assert {125, 131, 149} <= set(rows.tolist())


Spoil = Callable[[Arrays, Lines], object]


def array(name: str, change: Callable[[Any], Any]) -> Spoil:
    return lambda arrays, lines: arrays.update({name: change(arrays[name])})


def cell(name: str, value: Any) -> Spoil:
    return lambda arrays, lines: lines[1].update({name: value})


def without(name: str) -> Spoil:
    return lambda arrays, lines: [line.pop(name) for line in lines]


@pytest.mark.parametrize(
    ("spoil", "error", "says"),
    [
        (array("object_imu", lambda imu: imu[:-1]), NotANumber, "a copy cut short"),
        (array("xela", lambda _: np.array([None])), NotANumber, "pickled objects"),
        (without("frequency_hz"), ColumnError, "missing: .*frequency_hz"),
        (cell("start_index", "soon"), NotANumber, "'soon'"),
    ],
)
def test_a_spoilt_folder_gets_one_clear_line(
    tmp_path: Path,
    spoil: Spoil,
    error: type[Exception],
    says: str,
) -> None:
    arrays, lines = made_parts()
    spoil(arrays, lines)
    with pytest.raises(error, match=says) as caught:
        load(write(tmp_path, arrays, lines))
    assert "\n" not in str(caught.value)
    assert "next:" in str(caught.value)


def test_the_real_set_has_the_windows_its_readme_counts(
    real_set: Callable[[str], Path],
) -> None:
    root = real_set("human_slip_uskin")
    data = load(root)
    assert (len(data.recordings), len(data.groups())) == (676, 18)
    assert len(data.tasks["situations"]) == 70_489
    assert sum(len(recording.samples) for recording in data.recordings) == 497_675
    assert all(recording.valid.all() for recording in data.recordings)
    assert data.notes["unusable_trials"] == 0
    assert_equals_brute_force(data, root, [0, 337, 675])
