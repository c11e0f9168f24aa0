"""`holdfast replay`: one JSON line a sample, exactly the output contract, from the live path
alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hard_marks import GAPS
from packages import MAY_IMPORT

from holdfast.cli.main import main
from holdfast.core.contract import CLASSES, SITUATIONS, Prediction, Sample
from holdfast.core.errors import UnitError
from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import thesis
from holdfast.drivers.replay import PacedReplay, open_replay
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.edge_runtime.preparation import Preparation
from holdfast.live.outputs import to_json_line

if TYPE_CHECKING:
    from conftest import Built

ROOT = Path(__file__).resolve().parents[2]
TRIAL = "empty-bottle/pull/trial_1.csv"
Line = dict[str, Any]


def replayed(
    capsys: pytest.CaptureFixture[str], model: Path, trial: Path | str
) -> list[Line]:
    assert main(["replay", str(model), str(trial)]) == 0
    out, err = capsys.readouterr()
    assert all(line.startswith("cannot tell") for line in err.splitlines()), err
    return [json.loads(line) for line in out.splitlines()]


def test_every_sample_is_one_line_with_exactly_the_contracts_keys(
    eight_classes: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    trial = read_trial(eight_classes.fixture / TRIAL)
    lines = replayed(capsys, eight_classes.model, trial.path)
    assert len(lines) == len(trial.t_s)
    for sequence, line in enumerate(lines):
        assert list(line) == [field.name for field in fields(Prediction)]
        assert line["sequence"] == sequence
        assert line["t_acquired_ns"] == round(trial.t_s[sequence] * 1e9)
        assert (
            line["latency_us"] == (line["t_decided_ns"] - line["t_acquired_ns"]) / 1000
        )
        assert line["latency_us"] > 0
        assert set(line["p_situation"]) == set(SITUATIONS)
        assert sum(line["p_situation"].values()) == pytest.approx(1.0, abs=1e-5)
        assert line["p_risky"] == line["p_situation"]["risky_slip"]
        assert set(line["detectors"]) == {
            "band_pass",
            "band_pass_point",
            "friction_cone",
        }
        assert line["act"] <= line["arm"]
    assert {line["model_id"] for line in lines} == {
        Model(eight_classes.model).card.model_id
    }


def test_a_model_of_eight_classes_says_the_weight_of_what_is_held_and_of_nothing_none(
    eight_classes: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = replayed(capsys, eight_classes.model, eight_classes.fixture / TRIAL)
    assert {line["state"] for line in lines} >= {"unknown", "nothing", "risky_slip"}
    for line in lines:
        assert line["extra"] == {}
        if line["state"] in ("unknown", "nothing"):
            assert (line["p_class"], line["weight"]) == (None, None)
            continue
        assert set(line["p_class"]) == set(CLASSES)
        assert line["weight"] in ("light", "heavy")
        for situation in SITUATIONS:
            both = (
                line["p_class"][f"{situation}_light"]
                + line["p_class"][f"{situation}_heavy"]
            )
            assert line["p_situation"][situation] == pytest.approx(both, abs=1e-6)


def test_a_model_of_four_situations_knows_neither_weight_nor_class(
    four_situations: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = replayed(capsys, four_situations.model, four_situations.fixture / TRIAL)
    for line in lines:
        assert line["p_class"] is None
        assert line["weight"] is None
        assert 0.0 <= line["extra"]["p_risky_250ms"] <= 1.0
    assert len({line["extra"]["p_risky_250ms"] for line in lines}) > 1


def test_the_state_is_unknown_until_half_a_second_has_been_seen(
    eight_classes: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = replayed(capsys, eight_classes.model, eight_classes.fixture / TRIAL)
    assert [line["state"] == "unknown" for line in lines] == [
        k < 25 for k in range(len(lines))
    ]
    assert [line["settled"] for line in lines] == [k >= 25 for k in range(len(lines))]
    assert not any(line["arm"] or line["degraded"] for line in lines[:25])


def test_a_lost_sensor_in_the_recording_makes_the_state_unknown(
    eight_classes: Built, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = (eight_classes.fixture / TRIAL).read_text().splitlines()
    for line in range(101, 111):
        cells = rows[line].split(",")
        rows[line] = ",".join([*cells[:4], "nan", *cells[5:]])
    broken = tmp_path / "trial_1.csv"
    broken.write_text("\n".join(rows) + "\n")
    lines = replayed(capsys, eight_classes.model, broken)
    assert [
        k for k, line in enumerate(lines) if line["state"] == "unknown" and k >= 25
    ] == list(range(100, 135))


@GAPS.mark
@pytest.mark.parametrize(("missing", "blind"), [(1, False), (2, True), (500, True)])
def test_samples_that_never_came_are_lost_samples(
    eight_classes: Built, missing: int, blind: bool
) -> None:
    """At 50 Hz, 20 ms are one sample: a longer gap leaves half a second of history that is not the
    hand's own."""
    monitor = GripMonitor(Model(eight_classes.model), None)
    step_ns, fine = 20_000_000, np.ones(6, dtype=np.bool_)
    noise = np.random.default_rng(0).normal(0.0, 0.02, (60, 18))
    before = [monitor.feed(Sample(k * step_ns, noise[k], fine, k)) for k in range(40)]
    assert before[-1].state != "unknown"
    late = [40 + missing + k for k in range(20)]
    after = [
        monitor.feed(Sample(k * step_ns, row, fine, k))
        for k, row in zip(late, noise[40:], strict=True)
    ]
    assert {answer.state == "unknown" for answer in after} == {blind}


def answers(lines: list[Line]) -> list[Line]:
    """Without what depends on when it was computed."""
    return [
        {
            key: value
            for key, value in line.items()
            if key not in ("t_decided_ns", "latency_us")
        }
        for line in lines
    ]


def test_a_folder_a_file_a_url_and_a_trial_of_the_set_are_the_same_trial(
    eight_classes: Built, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = eight_classes.fixture / TRIAL
    # a number sign in a path does not make it a trial of a set
    folder = tmp_path / "set #2"
    folder.mkdir()
    copy = shutil.copy(file, folder / "tactile.csv")
    names = [recording.trial_id for recording in eight_classes.data.recordings]
    number = names.index(TRIAL.removesuffix(".csv"))
    named = f"{eight_classes.fixture}#{names[number]}"
    numbered = f"{eight_classes.fixture}#{number}"
    runs = [
        replayed(capsys, eight_classes.model, t)
        for t in (file, folder, copy, f"replay://{file}", named, numbered)
    ]
    for other in runs[1:]:
        assert answers(other) == answers(runs[0])


def test_a_replay_is_what_the_monitor_says_live(
    eight_classes: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    model = Model(eight_classes.model)
    source = open_replay(eight_classes.fixture / TRIAL).prepared(model.card.preparation)
    monitor = GripMonitor(model, None)
    first = [json.loads(to_json_line(monitor.feed(sample))) for sample in source]
    monitor.reset()
    again = [json.loads(to_json_line(monitor.feed(sample))) for sample in source]
    assert answers(again) == answers(first)
    assert answers(first) == answers(
        replayed(capsys, eight_classes.model, eight_classes.fixture / TRIAL)
    )


def test_the_unit_is_the_nearest_meta_jsons_and_newton_without_one(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "set" / "object" / "action"
    folder.mkdir(parents=True)
    trial = folder / "trial_1.csv"
    trial.write_text("Time,X1,Y1,Z1\n0.00,1,2,3\n0.02,1,2,3\n0.04,1,2,3\n")
    assert open_replay(trial).unit == "N"
    (tmp_path / "set" / "meta.json").write_text('{"unit": "uT"}')
    assert open_replay(trial).unit == "uT"
    (folder / "meta.json").write_text('{"by": "a person"}')
    assert open_replay(trial).unit == "uT"
    (folder / "meta.json").write_text('{"unit": "count"}')
    assert open_replay(trial).unit == "count"
    for wrong in ('{"unit": "kg"}', '{"unit": ["N"]}', "[]", "{", "\xff"):
        (folder / "meta.json").write_text(wrong, encoding="latin-1")
        with pytest.raises(UnitError):
            open_replay(trial)


def short_trial(folder: Path) -> Path:
    folder.mkdir(parents=True)
    trial = folder / "trial_1.csv"
    rows = [f"{0.02 * k:.2f},{k},2,{10 * k}" for k in range(4)]
    trial.write_text("\n".join(["Time,X1,Y1,Z1", *rows]) + "\n")
    return trial


@pytest.mark.parametrize(
    ("up", "unit"), [(0, "uT"), (1, "uT"), (3, "uT"), (4, "N"), (5, "N")]
)
def test_a_meta_json_counts_up_to_three_folders_above_the_trial(
    tmp_path: Path, up: int, unit: str
) -> None:
    trial = short_trial(tmp_path / "a/b/c/d/e/f")
    (trial.parents[up] / "meta.json").write_text('{"unit": "uT"}')
    assert open_replay(trial).unit == unit


@pytest.mark.parametrize(("number", "zero"), [(1, "first samples"), (2, "measured")])
def test_a_file_says_that_sign_and_zero_are_removed_and_in_which_unit(
    tmp_path: Path, number: int, zero: str
) -> None:
    trial = short_trial(tmp_path / "action")
    lines = trial.read_text().splitlines()
    marked = [lines[0] + ",prepared_uT", *(f"{line},{number}" for line in lines[1:])]
    replay = open_replay(trial)
    assert (replay.zero, replay.unit) == (None, "N")
    model = Preparation(bias_rows=2)
    assert replay.prepared(model).values[:2, 2].tolist() == [-5.0, 5.0]
    trial.write_text("\n".join(marked) + "\n")
    replay = open_replay(trial)
    assert (replay.zero, replay.unit) == (zero, "uT")
    assert replay.prepared(model) is replay
    recording = thesis.prepared(read_trial(trial), "uT", "trial")
    np.testing.assert_array_equal(recording.samples, replay.values)


def test_rows_that_are_not_valid_teach_neither_replay_nor_training(
    tmp_path: Path,
) -> None:
    path = tmp_path / "trial_1.csv"
    rows = [f"{0.02 * k:.2f},0,0,{-150 if k < 3 else 2},{int(k > 2)}" for k in range(9)]
    path.write_text("\n".join(["Time,X1,Y1,Z1,valid1", *rows]) + "\n")
    replayed = open_replay(path).prepared(thesis.preparation("N")).values
    trained = thesis.prepared(read_trial(path), "N", "trial").samples
    assert not replayed[3:].any()
    np.testing.assert_array_equal(replayed, trained)


def test_a_recording_goes_row_by_row_at_its_own_rate_and_may_begin_anew(
    tmp_path: Path,
) -> None:
    replay = open_replay(short_trial(tmp_path / "action"))
    assert (replay.rate_hz, replay.t_ns.tolist()) == (
        pytest.approx(50.0),
        [0, 20_000_000, 40_000_000, 60_000_000],
    )
    assert [(one.t_ns, one.sequence) for one in replay] == [
        (20_000_000 * k, k) for k in range(4)
    ]
    now_ns = [7_000_000_000]
    source = PacedReplay(replay, lambda: now_ns[0])
    assert (source.unit, source.n_channels, source.rate_hz) == ("N", 3, replay.rate_hz)
    for _ in range(2):
        began_ns = now_ns[0]
        # a row's time has come half a period before it; a late reader gets the newest
        for after_ms, row in ((0, 0), (9, 0), (11, 1), (49, 2), (60, 3), (69, 3)):
            now_ns[0] = began_ns + 1_000_000 * after_ms
            reading = source.read()
            assert reading is not None
            assert (reading.t_ns, reading.values.tolist()) == (
                now_ns[0],
                [row, 2.0, 10.0 * row],
            )
        now_ns[0] = began_ns + 71_000_000
        assert source.read() is None
        source.begin_anew()


def live_path(folder: Path) -> dict[str, str]:
    """An environment with numpy and onnxruntime and nothing else, and the packages a hand
    has."""
    packages = Path(sysconfig.get_paths()["platlib"])
    others = set(MAY_IMPORT) - {"core", "edge_runtime", "drivers", "live", "cli"}
    left_out = shutil.ignore_patterns("__pycache__", *others)
    shutil.copytree(ROOT / "holdfast", folder / "holdfast", ignore=left_out)
    for package in ("msgspec", "numpy", "numpy.libs", "onnxruntime"):
        if (packages / package).exists():
            (folder / package).symlink_to(packages / package)
    return {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}


def test_a_replay_needs_numpy_and_onnxruntime_and_no_other_package_or_room(
    eight_classes: Built, tmp_path: Path
) -> None:
    environment = live_path(tmp_path)
    trial = eight_classes.fixture / TRIAL

    def hand(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-S", "-m", "holdfast", *words]
        return subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    done = hand("replay", str(eight_classes.model), str(trial))
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == len(read_trial(trial).t_s)
    for words in (("train",), ("export",), ("evaluate", "m.onnx", "--data", "x")):
        refused = hand(*words)
        assert refused.returncode == 2
        assert refused.stderr.startswith("error: UsageError: this needs the package ")
        assert len(refused.stderr.splitlines()) == 1
    assert hand("doctor").returncode == 0
