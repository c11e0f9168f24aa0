"""`holdfast check`: what a folder holds, what is missing, and what to write where."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, fails
from own_data import write_meta, write_people_folders, write_phases

from holdfast.core.contract import channel_names
from holdfast.core.trial_layout import intent_path, truth_path
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
    assert "p01 soft-ball pull 1 50 N 15.1 (table) generated fixture" in lines
    assert "p02 hard-ball fall 1 50 N 197.9 (table) script, action at 7 s" in lines


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
    first = cell(report, "p01", "soft-ball", "pull")
    assert (first["rate_hz"], first["unit"]) == (50.0, "uT")
    assert (first["mass_g"], first["mass_from"]) == (20.0, "masses_g")
    assert first["labels_by"] == {"generated fixture": 1}
    other = cell(report, "p02", "hard-ball", "fall")
    assert other["mass_from"].endswith("p02/hard-ball/meta.json")
    assert other["labels_by"] == {"script, action at 6.8 s": 1}
    moved = cell(report, "p02", "soft-ball", "pull")
    assert moved["labels_by"] == {"script, action at 6.9 s (truth file)": 1}
    assert (report["readable"], report["trainable"]) == (True, True)
    seconds = {one["situation"]: one for one in report["classes"]}
    assert seconds["risky_slip"]["light_s"] > 0 < seconds["risky_slip"]["heavy_s"]


def without_a_mass(own: Path) -> None:
    (own / "p01/soft-ball").rename(own / "p01/mug")


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
    without_a_mass(own)
    report = reported(run, own)
    assert (report["readable"], report["trainable"]) == (True, True)
    said = missing(report, "advice")
    assert f"{own}/p01/mug no mass given for object 'mug'" in said
    assert "does not learn light and heavy weigh it" in said
    assert 'mug/meta.json: {"mass_g": 120.0}' in said
    by_name = {one["situation"]: one for one in report["classes"]}
    assert by_name["grasp"]["unweighed_s"] > 0 < by_name["grasp"]["light_s"]
    code, out, _ = run("check", own)
    assert "situation   light, s  heavy, s  mass unknown, s" in out
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
