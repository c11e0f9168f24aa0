"""`holdfast check`: what a folder holds, what is missing, and what to write where."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, fails
from own_data import rewrite, write_meta, write_people_folders, write_phases

from holdfast.core.contract import SITUATIONS, channel_names
from holdfast.core.errors import DataError, EmptyRecording
from holdfast.core.hand_card import HANDS
from holdfast.core.trial_file import read_trial
from holdfast.core.trial_layout import intent_path, truth_path
from holdfast.data.datasets import load
from holdfast.data.datasets.trials import DoubtfulData
from holdfast.edge_runtime.wearer import INTENT_HEADER

PULL, FALL = "soft-ball/pull/trial_1.csv", "hard-ball/fall/trial_1.csv"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_people_folders(tmp_path_factory.mktemp("made"))


@pytest.fixture
def own(made: Path, tmp_path: Path) -> Path:
    """Two people with a pull, a fall and a put-down each, labelled by the script but for one."""
    root = tmp_path / "own"
    for person in ("p01", "p02"):
        for trial in (
            PULL,
            FALL,
            "soft-ball/pass/trial_1.csv",
            "hard-ball/pass/trial_1.csv",
        ):
            (root / person / trial).parent.mkdir(parents=True)
            shutil.copy(made / person / trial, root / person / trial)
    shutil.copy(truth_path(made / "p01" / PULL), truth_path(root / "p01" / PULL))
    write_meta(root, unit="N")
    return root


def cell(report: dict, person: str, name: str, action: str) -> dict:
    wanted = {"person": person, "object_name": name, "action": action}
    return next(one for one in report["cells"] if wanted.items() <= one.items())


def reported(run: Run, folder: Path, code: int = 0) -> dict:
    got, out, _ = run("check", folder, "--json")
    assert got == code
    report: dict = json.loads(out)
    return report


def test_every_person_object_and_action_has_its_line(run: Run, own: Path) -> None:
    code, out, _ = run("check", own)
    assert code == 0
    assert "8 trials of 2 people" in out
    assert "held out by person: 2 people" in out
    assert out.endswith("ready for holdfast train and holdfast evaluate\n")
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "p01 soft-ball pull 1 15.1 (table) generated fixture" in lines
    assert "p02 hard-ball fall 1 197.9 (table) script, action at 7 s" in lines


def test_the_json_has_rate_unit_mass_labels_and_their_sources(
    run: Run, own: Path
) -> None:
    write_meta(own, unit="uT", action_at_s=6.8, masses_g={"soft-ball": 20})
    write_meta(own / "p02/hard-ball", mass_g=200)
    truth_path(own / "p02" / PULL).write_text('{"action_at_s": 6.9}')
    report = reported(run, own)
    assert (report["layout"], report["held_out_by"], report["channels"]) == (
        "thesis",
        "person",
        18,
    )
    assert (report["rate_hz"], report["unit"]) == (50.0, "uT")
    first = cell(report, "p01", "soft-ball", "pull")
    assert (first["mass_g"], first["mass_from"]) == (20.0, "masses_g")
    assert first["labels_by"] == {"generated fixture": 1}
    other = cell(report, "p02", "hard-ball", "fall")
    assert other["mass_from"].endswith("p02/hard-ball/meta.json")
    assert other["labels_by"] == {"script, action at 6.8 s": 1}
    moved = cell(report, "p02", "soft-ball", "pull")
    assert moved["labels_by"] == {"script, action at 6.9 s (truth file)": 1}
    assert (report["readable"], report["trainable"]) == (True, True)
    windows = report["windows"]
    assert windows["risky_slip_light"] > 0 < windows["risky_slip_heavy"]


def with_a_trial_off_the_script(own: Path) -> None:
    truth_path(own / "p02" / FALL).write_text('{"action_at_s": 0.5}')


def with_an_unknown_action(own: Path) -> None:
    (own / "p02/hard-ball/fall").rename(own / "p02/hard-ball/drop")


def with_another_rate(own: Path) -> None:
    path = own / "p02" / FALL
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *lines[1::2]]))


def with_an_unknown_column(own: Path) -> None:
    path = own / "p02" / FALL
    path.write_text(path.read_text().replace("X1", "Thumb", 1))


def with_an_unknown_unit(own: Path) -> None:
    write_meta(own, unit="lbf")


FAULTS: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "the script": (
        with_a_trial_off_the_script,
        "start at 0.5 s",
        "to trial_1.truth.json",
    ),
    "an action": (
        with_an_unknown_action,
        "'drop' is not an action",
        "pass, put-down, pull, fall",
    ),
    "a rate": (with_another_rate, "runs at 25 Hz", "a set of its own"),
    "a column": (with_an_unknown_column, "X1", "the layout is Time,X1,Y1,Z1"),
    "a unit": (with_an_unknown_unit, "unit = 'lbf'", "allowed: N or uT or count"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_says_what_to_write_where_and_the_rest_is_read(
    run: Run, own: Path, fault: str
) -> None:
    spoil, what, next_step = FAULTS[fault]
    spoil(own)
    report = reported(run, own, code=3)
    errors = [one for one in report["missing"] if one["level"] == "error"]
    assert len(errors) == 1
    assert what in errors[0]["what"]
    assert next_step in errors[0]["next_step"]
    assert sum(one["read"] for one in report["cells"]) in (6, 7, 8, 0)
    assert (report["cells"] == []) == (fault == "a unit")
    code, out, _ = run("check", own)
    assert code == 3
    assert "not ready: correct each ERROR" in out


def missing(report: dict, level: str) -> str:
    return "\n".join(
        f"{one['where']} {one['what']} {one['next_step']}"
        for one in report["missing"]
        if one["level"] == level
    )


def test_an_object_without_a_mass_is_trained_on_and_said(run: Run, own: Path) -> None:
    (own / "p01/soft-ball").rename(own / "p01/mug")
    report = reported(run, own)
    assert (report["readable"], report["trainable"]) == (True, True)
    said = missing(report, "advice")
    assert f"{own}/p01/mug no mass given for object 'mug'" in said
    assert "does not learn light and heavy weigh it" in said
    assert 'mug/meta.json: {"mass_g": 120.0}' in said
    assert report["windows"].keys() == set(SITUATIONS)
    code, out, _ = run("check", own)
    assert "windows (nothing " in out
    assert (code, "ready for holdfast train and" in out) == (0, True)


def test_one_situation_alone_is_nothing_to_train_on(run: Run, tmp_path: Path) -> None:
    write_phases(tmp_path / "mug/pull/trial_1.csv", "risky_slip")
    report = reported(run, tmp_path)
    assert (report["readable"], report["trainable"]) == (True, False)
    assert "no grasp: a model cannot tell it" in missing(report, "training")
    assert (
        "ready for holdfast evaluate; holdfast train needs" in run("check", tmp_path)[1]
    )


def test_the_wearers_command_next_to_a_trial_is_no_trial(run: Run, own: Path) -> None:
    before = reported(run, own)
    intent_path(own / "p01" / PULL).write_text(f"{INTENT_HEADER}\n0.5,7,open\n")
    assert reported(run, own) == before


def test_an_absent_folder_is_one_line(run: Run, tmp_path: Path) -> None:
    fails(run, 3, "DataNotFound", "check", tmp_path / "nowhere")


def test_a_rate_that_is_too_low_for_training_is_an_error_of_the_set(
    run: Run, tmp_path: Path
) -> None:
    rows = np.random.default_rng(0).normal(0.0, 0.01, (600, 18))
    rows[200:400, 2::3] += 2.0
    table = np.column_stack([np.arange(600) / 15.0, rows])
    for action in ("slip", "hold"):
        place = tmp_path / "set/mug" / action / "trial_1.csv"
        place.parent.mkdir(parents=True)
        header = ",".join(("Time", *channel_names(6)))
        np.savetxt(place, table, delimiter=",", header=header, comments="")
    code, out, _ = run("check", tmp_path / "set")
    assert code == 3
    assert f"ERROR {tmp_path / 'set'}: 15 Hz carries none of the bands" in out


# -- what would make figures silently wrong


def cut_off(own: Path) -> None:
    rewrite(own / "p01" / PULL, lambda table: table[:200])


def begun_anew(own: Path) -> None:
    # the first two seconds are gone, and time counts from the first row that is left
    def late(table: np.ndarray) -> np.ndarray:
        left = table[table[:, 0] > 2.0]
        left[:, 0] -= left[0, 0]
        more = np.repeat(left[-1:], 120, axis=0)
        more[:, 0] += np.arange(1, 121) / 50.0
        return np.vstack([left, more])

    rewrite(own / "p01" / PULL, late)


def in_millinewtons(own: Path) -> None:
    def thousandfold(table: np.ndarray) -> np.ndarray:
        table[:, 1:] *= 1000.0
        return table

    rewrite(own / "p01" / PULL, thousandfold)


def with_a_normal_axis_outwards(own: Path) -> None:
    def turned(table: np.ndarray) -> np.ndarray:
        table[:, 6] = np.abs(table[0, 6]) - np.abs(table[:, 6])
        return table

    for path in own.rglob("trial_1.csv"):
        rewrite(path, turned)


def with_three_sensors(own: Path) -> None:
    for path in own.rglob("trial_1.csv"):
        columns = path.read_text().splitlines()
        lines = [",".join(line.split(",")[:10]) for line in columns]
        path.write_text("\n".join(lines) + "\n")


def with_another_hands_card(own: Path) -> None:
    with_three_sensors(own)
    shutil.copy(HANDS / "two-pad-gripper.toml", own / "hand.toml")


WRONG: dict[str, tuple[Callable[[Path], None], str, str, str]] = {
    "cut off": (cut_off, "error", "labels reach", "copy the trial again"),
    "begun anew": (begun_anew, "doubt", "a label begins at", "times of its truth"),
    "mN": (in_millinewtons, "error", "N a side", "holdfast import --unit"),
    "sign": (with_a_normal_axis_outwards, "doubt", "sensor 2 reads below", "Z2 by -1"),
    "no card": (with_three_sensors, "doubt", "3 sensors and no hand card", "thumb"),
    "card": (with_another_hands_card, "error", "card of another hand", "put the card"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_would_make_figures_wrong_is_named_and_training_refuses_or_warns(
    run: Run, own: Path, what: str
) -> None:
    spoil, level, fault, next_step = WRONG[what]
    spoil(own)
    report = reported(run, own, code=3 if level == "error" else 0)
    found = [one for one in report["missing"] if one["level"] == level]
    assert len(found) == 1
    assert fault in found[0]["what"]
    assert next_step in found[0]["next_step"]
    ready = run("check", own)[1].splitlines()[-1]
    assert ready != "ready for holdfast train and holdfast evaluate"
    if level == "error":
        with pytest.raises(DataError, match=fault):
            load(own)
    elif what != "no card":  # which matters to pooled features alone
        with pytest.warns(DoubtfulData, match=fault):
            load(own)


def test_a_recording_that_lost_rows_is_told_by_its_meta_json(tmp_path: Path) -> None:
    folder = tmp_path / "p01/mug/hold/trial_1"
    rows = [f"{k / 50:.2f},0,0,{float(50 < k < 100)}" for k in range(120)]
    write_phases(folder / "tactile.csv", "grasp")
    (folder / "tactile.csv").write_text("\n".join(["Time,X1,Y1,Z1", *rows]) + "\n")
    write_meta(
        folder,
        recorder=1,
        state="kept",
        unit="N",
        person="p01",
        object="mug",
        action="hold",
        quality={"samples": 200},
    )
    with pytest.raises(EmptyRecording, match=r"120 rows, and .* says 200"):
        load(tmp_path)


def test_every_trial_that_cannot_be_read_is_named_and_a_torn_one_can_be_repaired(
    run: Run, own: Path, tmp_path: Path
) -> None:
    for person in ("p01", "p02"):
        path = own / person / PULL
        path.write_text(path.read_text()[:-30])
    out = run("check", own)[1]
    for person in ("p01", "p02"):
        assert f"{person}/{PULL}" in out
    assert "-> remove the last line, which was cut off" in out
    torn = tmp_path / "trial 1/tactile.csv"
    torn.parent.mkdir()
    torn.write_text("Time,X1,Y1,Z1\n0.00,1,2,3\n0.02,1,2,3\n0.04,1")
    with pytest.raises(DataError, match=f"holdfast check '{torn.parent}' --repair"):
        read_trial(torn)


def test_the_files_beside_a_trial_are_at_their_place(run: Run, own: Path) -> None:
    before = reported(run, own)
    (own / "p01" / PULL).with_name("trial_1.motion.csv").write_text("Time,x\n0,1\n")
    assert reported(run, own) == before
    (own / "p01" / PULL).with_name("take_9.csv").write_text("Time,x\n0,1\n")
    assert "CSV files at no trial's place: 1" in missing(reported(run, own), "advice")


def test_a_grip_above_the_ceiling_of_the_hand_is_doubtful(
    run: Run, own: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert not missing(reported(run, own), "doubt")
    Path("holdfast.toml").write_text("ceiling_n = 0.5\n")
    assert "more than ceiling_n = 0.5" in missing(reported(run, own), "doubt")
