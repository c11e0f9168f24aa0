"""`holdfast import`: logs of other programs become trials, by a map that may be proposed."""

from __future__ import annotations

import importlib
import json
import os
import pty
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, fails
from foreign_logs import RATE_HZ, Made, axes, made, write_sheet, write_text

from holdfast.core.column_map import column_map_of
from holdfast.core.errors import LibraryMissing
from holdfast.core.trial_file import read_trial
from holdfast.interop.logs.find import find_logs, read_log
from holdfast.interop.logs.layout import TableFormat

SENSORS = "".join(
    f'[[sensors]]\nx = "s{k}_x"\ny = "s{k}_y"\nz = "s{k}_z"\n' for k in range(1, 6)
)


@pytest.fixture
def one() -> Made:
    return made(1)


def semicolons(path: Path, one: Made) -> str:
    rows = np.column_stack([1e3 * one.t_s + 5e6, 1e3 * one.values])
    names = ["time [ms]", *axes(5, "s{k}_{axis} [mN]")]
    write_text(path, names, rows, separator=";", decimal=",", bom=True, head="Labor 7")
    return "mN"


def tabs_with_comments(path: Path, one: Made) -> str:
    rows = np.column_stack([1e6 * one.t_s, one.values / 9.80665e-3])
    names = ["# t_us", *axes(5, "F{k}{axis}_gf")]
    write_text(path, names, rows, separator="\t", head="# made by a rig\n# 2024")
    return "gf"


def spaces_without_a_clock(path: Path, one: Made) -> str:
    rows = np.column_stack([np.arange(len(one.t_s)), one.values])
    write_text(path, ["index", *axes(5)], rows, separator=" ")
    return "N"


def units_below_the_names(path: Path, one: Made) -> str:
    names = ["Zeit", *axes(5, "Finger {k} {axis}")]
    units = ";".join(["s", *["N"] * 15])
    rows = np.column_stack([one.t_s, one.values])
    write_text(path, [units], rows, separator=";", head=";".join(names))
    return "N"


STYLES: dict[str, Callable[[Path, Made], str]] = {
    style.__name__: style
    for style in (
        semicolons,
        tabs_with_comments,
        spaces_without_a_clock,
        units_below_the_names,
    )
}


@pytest.mark.parametrize("style", STYLES)
def test_a_text_table_of_any_form_becomes_the_same_trial(
    run: Run, tmp_path: Path, one: Made, style: str
) -> None:
    unit = STYLES[style](tmp_path / "p01_mug_slip_3.csv", one)
    words = ("import", tmp_path / "p01_mug_slip_3.csv", "--out", tmp_path / "set")
    code, out, err = run(*words)
    assert code == 2, err
    proposed = tmp_path / "set-map.toml"
    assert f'unit = "{unit}"' in out
    assert f"--map {proposed}" in out
    if style == "spaces_without_a_clock":
        fails(run, 3, "CardError", *words, "--map", proposed, says="time.rate_hz = 0")
        proposed.unlink()
        fails(
            run, 3, "CardError", *words, "--yes", says="time.rate_hz = 0: rows a second"
        )
        text = proposed.read_text("utf-8").replace("rate_hz = 0", "rate_hz = 100")
        proposed.write_text(text, "utf-8")
    code, out, err = run(*words, "--map", proposed)
    assert code == 0, out + err
    trial = read_trial(tmp_path / "set/p01/mug/slip/trial_1.csv")
    np.testing.assert_allclose(trial.raw, one.values, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(trial.t_s, one.t_s, atol=1e-6)
    assert json.loads((tmp_path / "set/meta.json").read_text())["unit"] == "N"
    assert "5 sensors" in out
    card = (tmp_path / "set/hand.toml").read_text("utf-8")
    assert card.count("[[sensors]]") == 5
    assert "correct" in card
    code, out, _ = run("check", tmp_path / "set")
    assert code == 0, out


def test_a_proposed_map_is_taken_with_yes(run: Run, tmp_path: Path, one: Made) -> None:
    semicolons(tmp_path / "p01_mug_slip_3.csv", one)
    words = ("import", tmp_path / "p01_mug_slip_3.csv", "--out", tmp_path / "set")
    code, out, _ = run(*words, "--yes")
    assert code == 0
    assert "1 trial, 5 sensors, in N" in out
    assert not (tmp_path / "set-map.toml").exists()
    assert column_map_of((tmp_path / "set/import.toml").read_text("utf-8")).unit == "mN"
    fails(run, 5, "OutputError", *words, "--yes", says="not empty")


def test_a_map_that_was_corrected_is_not_written_over(
    run: Run, tmp_path: Path, one: Made
) -> None:
    semicolons(tmp_path / "p01_mug_slip_3.csv", one)
    words = ("import", tmp_path / "p01_mug_slip_3.csv", "--out", tmp_path / "set")
    assert run(*words)[0] == 2
    assert run(*words)[0] == 2
    (tmp_path / "set-map.toml").write_text("# mine\n")
    fails(run, 5, "OutputError", *words, says="may hold your corrections")


def named_logs(folder: Path, *names: str) -> None:
    """A log for each name, with an axis in each heading."""
    for k, name in enumerate(names):
        one = made(k)
        rows = np.column_stack([one.t_s, one.values])
        write_text(folder / f"{name}.csv", ["time_s", *axes(5)], rows)


def test_all_that_a_map_misses_is_listed_at_once_with_the_columns_there_are(
    run: Run, tmp_path: Path, one: Made
) -> None:
    names = ["nr", *(f"{word}{k}" for k in range(5) for word in ("a", "b", "c"))]
    rows = np.column_stack([np.arange(len(one.t_s)) // 2, one.values])
    write_text(tmp_path / "logs/first.csv", names, rows)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    code, out, _ = run(*words)
    assert code == 2
    assert "out of nr, a0, b0, c0" in out
    fails(run, 3, "CardError", *words, "--yes", says="sensors[0].x")
    missing = [line for line in out.splitlines() if line.startswith("missing: line ")]
    keys = [line.split(": ")[2].split(" = ")[0] for line in missing]
    assert keys == ["time.rate_hz", "sensors[0].x", "facts.action"]
    whole = "; ".join(line.removeprefix("missing: ") for line in missing)
    fails(run, 3, "CardError", *words, "--map", tmp_path / "set-map.toml", says=whole)


def test_names_that_may_be_people_are_called_a_guess(run: Run, tmp_path: Path) -> None:
    named_logs(tmp_path / "logs", "anna_slip_1", "ben_slip_2", "anna_hold_3")
    _, out, _ = run("import", tmp_path / "logs", "--out", tmp_path / "set")
    assert 'path = "{object}_{action}_{trial}"' in out
    assert "# object: anna, ben: a guess; where they are people, write {person}" in out
    assert "# person: nothing says it" in out


SHEETS = {
    "ereignisse": "datei;von;bis;was\n{a};3.0;3.5;slip\n{b};3.1;3.6;slip\n",
    "b": "log;aa;bb;cc\n{a};3.0;3.5;slip\n{b};3.1;3.6;slip\n",
}


@pytest.mark.parametrize("name", SHEETS)
def test_a_sheet_with_foreign_headings_is_taken_by_its_cells(
    run: Run, tmp_path: Path, name: str
) -> None:
    logs = [f"p01_mug_{k}" for k in range(6)]
    named_logs(tmp_path / "logs", *logs)
    text = SHEETS[name].format(a=logs[0], b=logs[1])
    (tmp_path / f"logs/{name}.csv").write_text(text)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    code, out, err = run(*words, "--yes")
    assert code == 0, out + err
    assert 'path = "{person}_{object}_{trial}"' in out
    assert f"# events: {name}.csv, by its columns" in out
    assert 'slip = "risky_slip"' in out


def test_a_sheet_that_holds_no_events_is_named_and_skipped(
    run: Run, tmp_path: Path
) -> None:
    named_logs(tmp_path / "logs", *(f"p01_mug_slip_{k}" for k in range(5)))
    (tmp_path / "logs/weights.csv").write_text("thing,grams\nmug,198\ncup,90\n")
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    code, out, err = run(*words, "--yes")
    assert code == 0, out + err
    assert "# skipped: weights.csv, which has no sensor (columns thing, grams)" in out
    assert 'skip = ["weights"]' in out
    assert "5 trials" in out


def test_a_file_for_each_finger_is_noticed(run: Run, tmp_path: Path) -> None:
    named_logs(tmp_path / "logs", "a_slip_thumb", "a_slip_index")
    _, out, _ = run("import", tmp_path / "logs", "--out", tmp_path / "set")
    assert "looks like one finger of several" in out


EVENTS = '[events]\nfile = "e.csv"\nstart = "at"\nlabel = "what"\n[facts]'
ROWS = EVENTS.replace("[facts]", 'unit = "row"\n[facts]')


# -- one long file


def long_table(
    path: Path, trials: list[Made], gap_s: float, **columns: list[str]
) -> Path:
    """Trials one after the other on one clock, with texts in further columns."""
    rows, texts, at_s = [], [], 50.0
    for k, one in enumerate(trials):
        rows.append(np.column_stack([at_s + one.t_s, one.values]))
        at_s += one.t_s[-1] + 1.0 / RATE_HZ + gap_s
        texts += [",".join(cells[k] for cells in columns.values())] * len(one.t_s)
    names = ["time_s", *axes(5), *columns]
    return write_text(
        path, names, np.concatenate(rows), texts=texts if columns else None
    )


def test_a_long_file_is_cut_by_its_columns(run: Run, tmp_path: Path) -> None:
    trials = [made(k) for k in range(4)]
    long_table(
        tmp_path / "all.csv",
        trials,
        0.0,
        run=["r1", "r2", "r3", "r4"],
        subject=["anna", "anna", "ben", "ben"],
        condition=["slip", "no slip", "slip", "no slip"],
    )
    code, out, err = run("import", tmp_path, "--out", tmp_path / "set", "--yes")
    assert code == 0, out + err
    for k, place in enumerate(
        ["anna/object/slip", "anna/object/hold", "ben/object/slip", "ben/object/hold"]
    ):
        trial = read_trial(tmp_path / "set" / place / "trial_1.csv")
        np.testing.assert_allclose(trial.raw, trials[k].values, atol=1e-9)
    code, out, _ = run("check", tmp_path / "set")
    assert code == 0
    assert "held out by person: 2 people" in out


def test_a_long_file_is_cut_where_rows_are_missing(run: Run, tmp_path: Path) -> None:
    trials = [made(k) for k in range(3)]
    long_table(tmp_path / "log" / "p01_mug_slip.csv", trials, 4.0)
    code, out, err = run("import", tmp_path / "log", "--out", tmp_path / "set", "--yes")
    assert code == 0, out + err
    assert 'by = "gaps"' in out
    places = sorted((tmp_path / "set/p01/mug/slip").glob("trial_?.csv"))
    assert len(places) == 3
    np.testing.assert_allclose(read_trial(places[2]).raw, trials[2].values, atol=1e-9)


def test_a_long_file_is_cut_by_a_sheet_of_events(run: Run, tmp_path: Path) -> None:
    trials = [made(k) for k in range(2)]
    long_table(tmp_path / "log.csv", trials, 0.0)
    rows: list[list[object]] = [["begin", "finish", "what"]]
    for k in range(2):
        rows += [
            [5000 * k, 5000 * k + 4990, "torn away"],
            [3000 + 5000 * k, None, "slid"],
        ]
        rows += [[3500 + 5000 * k, None, "gone"]]
    write_sheet(tmp_path / "events.xlsx", rows, "Notes")
    (tmp_path / "map.toml").write_text(
        f'unit = "N"\n[time]\ncolumn = "time_s"\nunit = "s"\n{SENSORS}'
        '[trials]\nby = "events"\n[facts]\nperson = "p07"\nobject = "cup"\n'
        '[actions]\n"torn away" = "pull"\n[masses_g]\ncup = 198\n'
        '[events]\nfile = "events.xlsx"\nsheet = "Notes"\nstart = "begin"\nend = "finish"\n'
        'label = "what"\nunit = "ms"\nrest = "grasp"\n'
        '[events.labels]\nslid = "risky_slip"\ngone = ""\n'
    )
    words = ("import", tmp_path, "--out", tmp_path / "set", "--map")
    code, out, err = run(*words, tmp_path / "map.toml")
    assert code == 0, out + err
    place = tmp_path / "set/p07/cup/pull/trial_2.csv"
    np.testing.assert_allclose(read_trial(place).raw[:499], trials[1].values[:499])
    phases = json.loads(place.with_suffix(".truth.json").read_text())["phases"]
    assert [(one["t0_s"], one["label"]) for one in phases] == [
        (pytest.approx(1.0, abs=0.06), "grasp"),
        (3.0, "risky_slip"),
        (pytest.approx(3.5), "grasp"),
    ]
    assert json.loads((tmp_path / "set/meta.json").read_text())["masses_g"] == {
        "cup": 198
    }
    code, out, _ = run("check", tmp_path / "set")
    assert code == 0
    assert "198 (masses_g)  events" in out


def test_events_of_all_trials_in_one_sheet_go_to_their_logs(
    run: Run, tmp_path: Path
) -> None:
    source = tmp_path / "logs"
    rows: list[list[object]] = [["file", "start_ms", "end_ms", "label"]]
    for k in (1, 2):
        one = made(k)
        table = np.column_stack([one.t_s, one.values])
        write_text(source / f"p0{k}/mug_{k}.csv", ["t_s", *axes(5)], table)
        rows.append([f"mug_{k}.csv", 3000, 3500 + k, "Slipping"])
    # a trial without an event is held, and a name that no log has is a fault
    one = made(3)
    table = np.column_stack([one.t_s, one.values])
    write_text(source / "p03/mug_3.csv", ["t_s", *axes(5)], table)
    rows.append(["mug_3.csv", None, None, None])
    write_sheet(source / "notes.xlsx", [*rows, ["mug_4.csv", 1000, 2000, "Slipping"]])
    words = ("import", source, "--out", tmp_path / "set")
    assert run(*words)[0] == 2
    code, out, _ = run(*words, "--map", tmp_path / "set-map.toml")
    assert code == 3
    assert "notes.xlsx, line 5: 'mug_4.csv' is no log and no trial" in out
    write_sheet(source / "notes.xlsx", rows)
    (tmp_path / "set-map.toml").unlink()
    code, out, err = run(*words, "--yes")
    assert code == 0, out + err
    assert 'Slipping = "risky_slip"' in out
    held = json.loads((tmp_path / "set/p03/mug/daily/trial_1.truth.json").read_text())[
        "phases"
    ]
    assert [phase["label"] for phase in held] == ["grasp"]
    path = tmp_path / "set/p02/mug/daily/trial_1.truth.json"
    phases = json.loads(path.read_text())["phases"]
    assert [(p["t1_s"], p["label"]) for p in phases if p["label"] != "grasp"] == [
        (3.502, "risky_slip")
    ]


# -- faults


def by_map(
    run: Run, tmp_path: Path, old: str, new: str, begin_ms: float = 0.0
) -> tuple[int, str]:
    """Import two logs by a map in which something is other."""
    for k in (1, 2):
        one = made(k)
        rows = np.column_stack([begin_ms + 1e3 * one.t_s, one.values])
        write_text(tmp_path / f"logs/a_slip_{k}.csv", ["millis", *axes(5)], rows)
    text = (
        f'unit = "N"\n\n[time]\ncolumn = "millis"\nunit = "ms"\n\n{SENSORS}'
        '[trials]\npath = "a_{action}_{trial}"\n[facts]\nperson = "p01"\n'
    )
    assert old in text
    (tmp_path / "lab.toml").write_text(text.replace(old, new, 1))
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set", "--map")
    code, out, err = run(*words, tmp_path / "lab.toml")
    assert (tmp_path / "set").exists() == (code == 0)
    return code, out + err


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('unit = "ms"\n', "", "looks like milliseconds (100 Hz)"),
        ('z = "s2_z"', 'z = "s2_zz"', "no column s2_zz (line 14)"),
        ("a_{action}", "b_{action}", "lab.toml, line 28: path"),
        (
            '_{action}_{trial}"',
            '_*_{trial}"\naction = "x"',
            "no column x (trials.action)",
        ),
        ('_{action}_{trial}"', '_{object}_{trial}"', "no action is known of the trial"),
    ],
)
def test_a_fault_of_all_logs_is_one_with_the_line_of_the_map(
    run: Run, tmp_path: Path, old: str, new: str, says: str
) -> None:
    code, out = by_map(run, tmp_path, old, new)
    assert code == 3
    assert says in out
    assert "1 more like it" in out
    assert "nothing was written" in out


def test_faults_of_several_logs_are_all_told_and_nothing_is_written(
    run: Run, tmp_path: Path
) -> None:
    code, _ = by_map(run, tmp_path, "_{action}_{trial}", "_{action}_{trial}")
    assert code == 0
    source = tmp_path / "logs"
    lines = (source / "a_slip_1.csv").read_text().splitlines()
    (source / "a_slip_3.csv").write_text("\n".join([*lines[:50], *lines[40:60]]))
    (source / "a_slip_4.csv").write_text("\n".join(lines).replace("s1_x", "other"))
    (source / "a_fell_5.csv").write_text("\n".join(lines))
    (source / "a_slip_6.csv").write_text("\n".join([*lines[:9], "1,2", *lines[9:]]))
    (source / "a_slip_7.csv").write_bytes(bytes(300))
    words = (
        "import",
        source,
        "--out",
        tmp_path / "new",
        "--map",
        tmp_path / "lab.toml",
    )
    code, out, _ = run(*words, "--json")
    faults = json.loads(out)["faults"]
    assert code == 3
    assert [Path(fault["where"]).stem[2:] for fault in faults] == [
        "fell_5",
        "slip_3",
        "slip_4",
        "slip_6",
        "slip_7",
    ]
    assert faults[1]["what"].startswith("row 51: time runs backwards")
    assert faults[1]["map_line"] == 'line 4: column = "millis"'
    assert '"fell" = ..' in faults[0]["next_step"]
    assert not (tmp_path / "new").exists()


def test_a_label_that_is_not_known_names_its_line(run: Run, tmp_path: Path) -> None:
    events = '[events]\nfile = "e.csv"\nstart = "at"\nlabel = "what"\n'
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/e.csv").write_text("at,what\n0.5,grasp\n3,sliding\n")
    code, out = by_map(run, tmp_path, "[facts]", f"{events}[facts]")
    assert code == 3
    assert "e.csv, line 3: the label 'sliding' is no situation" in out
    assert 'add "sliding" = .. to [events.labels]' in out


def test_an_event_in_a_row_below_0_is_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/e.csv").write_text("at,what\n-1,nothing\n100,grasp\n")
    code, out = by_map(run, tmp_path, "[facts]", ROWS)
    assert code == 3
    assert "line 2: an event in row -1; the first row is 0" in out
    (tmp_path / "logs/e.csv").write_text("at,what\n0,nothing\n100,grasp\n")
    assert by_map(run, tmp_path, "[facts]", ROWS)[0] == 0


def test_milliseconds_declared_as_seconds_are_refused_before_anything_is_written(
    run: Run, tmp_path: Path
) -> None:
    code, out = by_map(run, tmp_path, 'unit = "ms"', 'unit = "s"')
    assert code == 3
    assert 'runs at 0.1 Hz (with unit = "ms": 100 Hz)' in out
    assert 'line 5: unit = "s"' in out
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("times", "more", "looks"),
    [
        ((500, 3000), "", 'unit = "ms", zero = "log"'),
        ((0.5, 3), 'zero = "clock"\n', 'unit = "s", zero = "log"'),
        ((50_000_000, 3e9), 'unit = "ms"\n', 'unit = "ns", zero = "log"'),
    ],
)
def test_events_outside_their_log_are_faults_that_name_what_would_fit(
    run: Run, tmp_path: Path, times: tuple[float, float], more: str, looks: str
) -> None:
    (tmp_path / "logs").mkdir()
    rows = "".join(f"{at},grasp\n" for at in times)
    (tmp_path / "logs/e.csv").write_text(f"at,what\n{rows}")
    events = EVENTS.replace("[facts]", f"{more}[facts]")
    code, out = by_map(run, tmp_path, "[facts]", events, begin_ms=60_000)
    assert code == 3
    assert "outside its log" in out
    assert f"looks like {looks}" in out
    assert "nothing was written" in out


def test_an_event_of_one_table_for_all_logs_need_only_lie_in_one_of_them(
    run: Run, tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/e.csv").write_text("at,what\n-1,nothing\n0.5,grasp\n99,grasp\n")
    code, out = by_map(run, tmp_path, "[facts]", EVENTS)
    assert code == 3
    assert "e.csv, line 4: 'grasp' begins at 99 s, outside its log" in out
    assert out.count("ERROR /") == 1
    ignored = EVENTS.replace("[facts]", '[events.labels]\ngrasp = ""\n[facts]')
    (tmp_path / "logs/e.csv").write_text("at,what\n99,grasp\n")
    code, out = by_map(run, tmp_path, "[facts]", ignored)
    assert code == 0, out


PAUSE_MAP = (
    f'unit = "N"\n[time]\ncolumn = "time_s"\nunit = "s"\n{SENSORS}'
    '[trials]\nby = "gaps"\n[facts]\naction = "slip"\n'
    '[events]\nfile = "e.csv"\nstart = "at"\nend = "to"\nlabel = "what"\n'
)


@pytest.mark.parametrize(
    ("rows", "faults", "notes"),
    [
        # trials of 5 s with a pause of 4 s between them
        ("3,3.5,risky_slip\n6,7,risky_slip\n", 0, ["line 3: 'risky_slip' at 6 s"]),
        ("6,7,risky_slip\n12,12.5,risky_slip\n", 0, ["line 2: 'risky_slip' at 6 s"]),
        ("4,10,risky_slip\n", 0, []),
        ("3,3,risky_slip\n3,3.5,risky_slip\n", 0, ["line 2: 'risky_slip' at 3 s"]),
        ("6,7,risky_slip\n7,8,risky_slip\n", 2, []),
        ("3,3.5,risky_slip\n6,7,risky_slip\n99,99.5,risky_slip\n", 1, None),
    ],
)
def test_an_event_in_the_pause_between_two_trials_is_named(
    run: Run, tmp_path: Path, rows: str, faults: int, notes: list[str] | None
) -> None:
    long_table(tmp_path / "logs/log.csv", [made(k) for k in range(2)], 4.0)
    (tmp_path / "logs/e.csv").write_text(f"at,to,what\n{rows}")
    (tmp_path / "map.toml").write_text(PAUSE_MAP)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    code, out, _ = run(*words, "--map", tmp_path / "map.toml", "--json", "-")
    found = json.loads(out)
    assert (code, len(found["faults"])) == (3 if faults else 0, faults)
    if notes is None:
        assert "outside its log" in found["faults"][0]["what"]
    elif faults:
        assert "is in no trial of its log, and no other" in found["faults"][0]["what"]
    else:
        where = f"{tmp_path}/logs/e.csv, "
        assert found["notes"] == [f"{where}{n} is in no trial: left out" for n in notes]


def test_an_event_between_the_trials_that_events_cut_is_named(
    run: Run, tmp_path: Path
) -> None:
    long_table(tmp_path / "logs/log.csv", [made(k) for k in range(2)], 0.0)
    (tmp_path / "logs/e.csv").write_text(
        "at,to,what\n0,4.9,pull\n3,3.5,risky_slip\n5,5.5,risky_slip\n6,9.9,pull\n"
    )
    cut = PAUSE_MAP.replace('"gaps"', '"events"').replace('action = "slip"', "")
    (tmp_path / "map.toml").write_text(cut)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    code, out, _ = run(*words, "--map", tmp_path / "map.toml")
    assert code == 0
    assert out.count("left out") == 1
    assert "e.csv, line 4: 'risky_slip' at 5 s is in no trial: left out" in out


def test_check_of_foreign_logs_proposes_the_import(run: Run, tmp_path: Path) -> None:
    by_map(run, tmp_path, "N", "N")
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
    fails(run, 3, "DataNotFound", "check", place, says=f"holdfast import {place}")


def test_a_folder_of_logs_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    for k in (10, 2, 1):
        write_text(tmp_path / f"t{k}.csv", ["t", "a"], np.arange(6.0).reshape(3, 2))
    (tmp_path / "readme.txt").write_text("What was done\nwith 3 fingers on 2 days.\n")
    (tmp_path / ".hidden.csv").write_text("a,b\n1,2\n")
    places = find_logs(tmp_path)
    assert [place.name for place in places] == ["t1", "t2", "t10"]
    log = read_log(places[0], TableFormat())
    assert log.names == ["t", "a"]


def test_a_terminal_is_asked_and_no_is_no(tmp_path: Path, one: Made) -> None:
    semicolons(tmp_path / "p01_mug_slip_3.csv", one)
    words = [sys.executable, "-m", "holdfast", "import", "p01_mug_slip_3.csv"]
    for answer, code in (("n", 2), ("y", 0)):
        master, slave = pty.openpty()
        os.write(master, f"{answer}\n".encode())
        done = subprocess.run(
            [*words, "--out", f"set-{answer}"],
            cwd=tmp_path,
            stdin=slave,
            stdout=slave,
            stderr=subprocess.PIPE,
            check=False,
        )
        shown = os.read(master, 1 << 16).decode()
        os.close(master)
        os.close(slave)
        assert done.returncode == code, done.stderr
        assert "# unit: mN, by the names" in shown
        assert (tmp_path / f"set-{answer}").exists() == (answer == "y")
        assert (tmp_path / f"set-{answer}-map.toml").exists() == (answer == "n")


@pytest.mark.parametrize(
    ("library", "extra", "module"),
    [("pandas", "train", "text_table"), ("openpyxl", "xlsx", "workbook")],
)
def test_a_missing_library_names_its_extra(
    monkeypatch: pytest.MonkeyPatch, library: str, extra: str, module: str
) -> None:
    # first with its library, and again without
    reader = importlib.import_module(f"holdfast.interop.logs.{module}")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(LibraryMissing, match=rf"pip install 'holdfast\[{extra}\]'"):
        importlib.reload(reader)


def test_dates_are_a_clock_and_a_counter_is_none(run: Run, tmp_path: Path) -> None:
    one = made(2)
    start = np.datetime64("2024-05-01T12:00:00.5")
    days = start + (1e6 * one.t_s).round().astype("timedelta64[us]")
    rows = np.column_stack([np.arange(len(one.t_s)), one.values])
    names = ["", *axes(5), "when"]
    write_text(tmp_path / "mug_slip.csv", names, rows, texts=[str(day) for day in days])
    words = ("import", tmp_path / "mug_slip.csv", "--out", tmp_path / "set", "--yes")
    code, out, err = run(*words)
    assert code == 0, out + err
    assert "# time: when, 100 Hz" in out
    (place,) = (tmp_path / "set").rglob("trial_1.csv")
    np.testing.assert_allclose(read_trial(place).t_s, one.t_s, atol=1e-6)


def test_a_slip_trial_without_a_row_of_events_is_not_labelled_as_a_grasp(
    run: Run, tmp_path: Path
) -> None:
    events = (
        '[events]\nfile = "e.csv"\ntrial = "file"\nstart = "at"\nend = "to"\n'
        'label = "what"\nrest = "grasp"\n'
    )
    (tmp_path / "logs").mkdir()
    rows = "file,at,to,what\na_slip_1,2,2.3,risky_slip\n"
    (tmp_path / "logs/e.csv").write_text(rows)
    code, out = by_map(run, tmp_path, "[facts]", f"{events}[facts]")
    assert code == 0, out
    _, out, _ = run("check", tmp_path / "set", "--json")
    labels = {
        k: n for cell in json.loads(out)["cells"] for k, n in cell["labels_by"].items()
    }
    assert labels.pop("events") == 1
    assert sum(labels.values()) == 1
