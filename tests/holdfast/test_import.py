"""`holdfast import` by a map, on a terminal, and where something is wrong."""

from __future__ import annotations

import importlib
import json
import os
import pty
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, fails, imported
from foreign_logs import axes, made, write_sheet, write_text

from holdfast.cli.main import main
from holdfast.core.errors import LibraryMissing
from holdfast.data.datasets import load
from holdfast.interop.formats.logs import find_logs

SENSORS = "".join(
    f'[[sensors]]\nx = "s{k}_x"\ny = "s{k}_y"\nz = "s{k}_z"\n' for k in range(1, 6)
)
MAP = (
    f'unit = "N"\n\n[time]\ncolumn = "millis"\nunit = "ms"\n\n{SENSORS}'
    '[trials]\npath = "a_{action}_{trial}"\n[facts]\nperson = "p01"\n'
)
EVENTS = '[events]\nfile = "e.csv"\nstart = "at"\nlabel = "what"\n[facts]'


def logs(folder: Path) -> None:
    """Two logs of slips."""
    for k in (1, 2):
        one = made(k)
        rows = np.column_stack([6e4 + 1e3 * one.t_s, one.values])
        write_text(folder / f"a_slip_{k}.csv", ["millis", *axes(5)], rows)


def by_map(run: Run, tmp_path: Path, old: str = "N", new: str = "N") -> tuple[int, str]:
    """Import two logs by a map in which something is other."""
    logs(tmp_path / "logs")
    assert old in MAP
    (tmp_path / "lab.toml").write_text(MAP.replace(old, new, 1))
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set", "--map")
    code, out, err = run(*words, tmp_path / "lab.toml")
    assert (tmp_path / "set").exists() == (code == 0)
    return code, out + err


def test_a_map_says_all_and_nothing_is_asked(run: Run, tmp_path: Path) -> None:
    facts = (
        'person = "p01"\nobject = "cup"\nkind = "simulated"\n[masses_g]\ncup = 198\n'
    )
    code, out = by_map(run, tmp_path, 'person = "p01"\n', facts)
    assert code == 0, out
    meta = json.loads((tmp_path / "set/meta.json").read_text())
    assert (meta["unit"], meta["kind"], meta["masses_g"]) == (
        "N",
        "simulated",
        {"cup": 198},
    )
    assert meta["imported"]["p01/cup/slip/trial_2.csv"] == "a_slip_2"
    assert (tmp_path / "set/hand.toml").read_text().count("[[sensors]]") == 5


def test_an_axis_that_no_column_has_stays_out_of_the_set(
    run: Run, tmp_path: Path
) -> None:
    sides = ["thumb", "thumb", "opposing", "opposing", "opposing"]
    sensors = [
        f'[[sensors]]\nname = "s{k}"\nside = "{side}"\nalong_mm = {k}\n'
        for k, side in enumerate(sides)
    ]
    card = "".join(sensors).replace("along_mm", 'measures = "yz"\nalong_mm', 1)
    (tmp_path / "hand.toml").write_text(card)
    code, out = by_map(run, tmp_path, 'x = "s1_x"\n', "")
    assert code != 0
    assert "no columns for X1, and no hand card says they are not measured" in out
    code, out = by_map(
        run, tmp_path, f'unit = "N"\n\n{MAP_TIME}x = "s1_x"\n', f"{HAND}{MAP_TIME}"
    )
    assert code == 0, out
    header = (tmp_path / "set/p01/object/slip/trial_1.csv").read_text().split("\n")[0]
    assert header.startswith("Time,Y1,Z1,X2,Y2,Z2")
    data = load(tmp_path / "set", windows="none")
    assert data.hand is not None
    assert data.hand.unmeasured_names == ("X1",)
    assert not data.recordings[0].samples[:, 0].any()
    assert data.recordings[0].valid.all()


HAND = 'unit = "N"\nhand = "hand.toml"\n\n'
MAP_TIME = '[time]\ncolumn = "millis"\nunit = "ms"\n\n[[sensors]]\n'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('unit = "ms"\n', "", "looks like milliseconds (100 Hz"),
        ('z = "s2_z"', 'z = "s2_zz"', "no column s2_zz"),
        (
            "a_{action}",
            "b_{action}",
            "a_slip_1 is not b_{action}_{trial} (trials.path)",
        ),
        ('_{trial}"', '_{trial}"\naction = "x"', "no column x; "),
        (
            "_{action}_{trial}",
            "_{object}_{trial}",
            "nothing says what happens in a_slip_1",
        ),
        ('"a_{action}', '"a_{object}', "nothing says what happens"),
        (
            "[facts]",
            EVENTS.replace("[facts]", 'zero = "clock"\n[facts]'),
            "no event of it lies",
        ),
    ],
)
def test_a_fault_is_named_with_its_log_and_nothing_is_written(
    run: Run, tmp_path: Path, old: str, new: str, says: str
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/e.csv").write_text("at,what\n0.5,nothing\n3,grasp\n")
    if "events" not in new:
        (tmp_path / "logs/e.csv").unlink()
    code, out = by_map(run, tmp_path, old, new)
    assert code == 3
    assert says in out
    assert str(tmp_path / "logs") in out


def test_a_word_that_is_no_action_is_answered_on_the_command_line(
    run: Run, tmp_path: Path
) -> None:
    logs(tmp_path / "logs")
    (tmp_path / "logs/a_slip_1.csv").rename(tmp_path / "logs/a_mended_1.csv")
    (tmp_path / "lab.toml").write_text(MAP)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    fails(
        run,
        3,
        "LabelError",
        *words,
        "--map",
        tmp_path / "lab.toml",
        says='"mended=slip"',
    )
    code, out, _ = run(*words, "--yes", "--action", "mended=hold")
    assert code == 0
    assert "2 trials: 1 hold, 1 slip" in out


def test_lines_of_another_length_are_left_out_and_counted(
    run: Run, tmp_path: Path
) -> None:
    logs(tmp_path / "logs")
    path = tmp_path / "logs/a_slip_1.csv"
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join([*lines[:90], lines[90] + ",1,2", *lines[91:], lines[1][:20]])
    )
    (tmp_path / "logs/a_slip_2.csv").unlink()
    out = imported(run, tmp_path)
    assert "2 lines of another number of cells left out" in out


@pytest.mark.parametrize(
    ("text", "code", "says"),
    [
        ("at,what\n0.5,grasp\n3,sliding\n", 3, "the label 'sliding' is no situation"),
        ("at,what\n-1,nothing\n3,grasp\n", 0, ""),
        ("at,to,what\n3,2,grasp\n", 3, "from 3 to 2 s is impossible"),
        ("begin,what\n3,grasp\n", 3, "e.csv: no column at; "),
    ],
)
def test_an_event_that_cannot_be_is_named(
    run: Run, tmp_path: Path, text: str, code: int, says: str
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/e.csv").write_text(text)
    events = (
        EVENTS.replace("[facts]", 'end = "to"\n[facts]') if ",to," in text else EVENTS
    )
    found, out = by_map(run, tmp_path, "[facts]", events)
    assert found == code, out
    assert says in out


def test_what_lasts_shorter_lies_within_what_lasts_longer(
    run: Run, tmp_path: Path
) -> None:
    rows: list[list[object]] = [
        ["begin", "finish", "what"],
        [1, 4, "grasp"],
        [3, 3.5, "slip"],
    ]
    logs(tmp_path / "logs")
    # a table for all would name its trials
    (tmp_path / "logs/a_slip_2.csv").unlink()
    write_sheet(tmp_path / "logs/events.xlsx", rows, "Notes")
    imported(run, tmp_path)
    (truth,) = sorted((tmp_path / "set").rglob("*.truth.json"))
    phases = [
        (p["t0_s"], p["t1_s"], p["label"])
        for p in json.loads(truth.read_text())["phases"]
    ]
    assert (3.0, 3.5, "risky_slip") in phases
    assert (3.5, 4.0, "grasp") in phases


def test_check_of_foreign_logs_proposes_the_import(run: Run, tmp_path: Path) -> None:
    logs(tmp_path / "logs")
    command = f"holdfast import {tmp_path}/logs --out {tmp_path}/logs-trials"
    code, out, _ = run("check", tmp_path / "logs")
    assert code == 3
    assert command in out
    # the same where folders are those of the layout, and only the columns are others
    place = tmp_path / "own/p01/mug/slip/trial_1.csv"
    place.parent.mkdir(parents=True)
    place.write_bytes((tmp_path / "logs/a_slip_1.csv").read_bytes())
    code, out, _ = run("check", tmp_path / "own")
    assert code == 3
    assert f"holdfast import {tmp_path}/own --out {tmp_path}/own-trials" in out


@pytest.mark.parametrize(
    ("name", "is_log"), [("metadata.yaml", True), ("a.jpg", False)]
)
def test_check_proposes_the_import_of_a_bag_and_not_of_pictures(
    run: Run, tmp_path: Path, name: str, is_log: bool
) -> None:
    (tmp_path / name).write_text("rosbag2_bagfile_information: {}\n")
    code, out, _ = run("check", tmp_path)
    assert code == 3
    assert ("holdfast import" in out) == is_log


def test_a_folder_is_read_in_the_order_of_its_numbers_and_names_what_is_no_log(
    tmp_path: Path,
) -> None:
    for k in (10, 2, 1):
        write_text(tmp_path / f"t{k}.csv", ["t", "a"], np.arange(6.0).reshape(3, 2))
    (tmp_path / "readme.txt").write_text("What was done\nwith 3 fingers on 2 days.\n")
    (tmp_path / ".hidden.csv").write_text("a,b\n1,2\n")
    places, others = find_logs(tmp_path)
    assert [place.name for place in places] == ["t1", "t2", "t10"]
    assert others == ["readme.txt"]


def test_labels_of_the_same_name_in_two_folders_are_both_found(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_text(tmp_path / folder / "t1.csv", ["t", "a"], np.ones((3, 2)))
        (tmp_path / folder / "t1.txt").write_text("0\t1\tgrasp\n1\t2\tslip\n")
    places, _ = find_logs(tmp_path)
    found = [place.path.relative_to(tmp_path).as_posix() for place in places]
    assert found == ["a/t1.csv", "a/t1.txt", "b/t1.csv", "b/t1.txt"]


def test_a_terminal_is_asked_and_no_is_no(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs(tmp_path / "logs")
    for path in (tmp_path / "logs").iterdir():
        path.rename(path.with_name(path.name.replace("_slip", "")))
    words = ["import", str(tmp_path / "logs"), "--out"]
    for answer, code in (("n", 2), ("y", 0)):
        master, slave = pty.openpty()
        os.write(master, f"slip\n{answer}\n".encode())
        with open(slave) as keys, open(os.dup(slave), "w") as screen:
            with monkeypatch.context() as patched:
                patched.setattr(sys, "stdin", keys)
                patched.setattr(sys, "stdout", screen)
                assert main([*words, str(tmp_path / f"set-{answer}")]) == code
            screen.flush()
            shown = os.read(master, 1 << 16).decode()
        os.close(master)
        assert "what happens in these trials?" in shown
        assert "2 trials: 2 slip" in shown
        assert (tmp_path / f"set-{answer}").exists() == (answer == "y")


def test_a_set_that_is_there_is_not_touched(run: Run, tmp_path: Path) -> None:
    logs(tmp_path / "logs")
    (tmp_path / "set").mkdir()
    (tmp_path / "set/a").write_text("")
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set", "--yes")
    fails(run, 5, "OutputError", *words, says="not empty")


@pytest.mark.parametrize(
    ("library", "extra", "module"),
    [("pandas", "train", "tables"), ("openpyxl", "xlsx", "workbook")],
)
def test_a_missing_library_names_its_extra(
    monkeypatch: pytest.MonkeyPatch, library: str, extra: str, module: str
) -> None:
    # first with its library, and again without
    reader = importlib.import_module(f"holdfast.interop.formats.{module}")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(LibraryMissing, match=rf"pip install 'holdfast\[{extra}\]'"):
        importlib.reload(reader)
