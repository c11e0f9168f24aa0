"""`holdfast import` of logs in the forms that people have: what went in comes out, or is asked."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from command_line import Run, imported
from foreign_logs import Made, axes, made, write_log, write_sheet, write_text

from holdfast.core.trial_file import read_trial

Trials = list[Made]
SLIP = ("--action", "slip")
CLOCK_S = 50_531.0
"""14:02:11, in s from midnight."""


def clock(t_s: float, form: str = "{h:02d}:{m:02d}:{s:06.3f}") -> str:
    """A time of day."""
    minutes, seconds = divmod(round(t_s % 86_400, 6), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return form.format(h=hours, m=minutes, s=seconds)


# -- readings of any form; nothing says what happens in them


def serial_monitor(path: Path, one: Made) -> None:
    numbers = zip(one.t_s, one.values[:, 0], strict=True)
    first = [f"{clock(CLOCK_S + t_s)} -> {number}" for t_s, number in numbers]
    write_text(path.with_suffix(".txt"), [], one.values[:, 1:], first=first)


def tabs_without_a_heading(path: Path, one: Made) -> None:
    rows = np.column_stack([one.t_s, one.values])
    write_text(path.with_suffix(".dat"), [], rows, separator="\t")


def utf16_with_comments(path: Path, one: Made) -> None:
    head = "# made by a rig\n# 2024, 15 channels"
    rows = np.column_stack([1e6 * one.t_s, one.values])
    names = ["# t_us", *axes(5, "F{k}{axis}")]
    write_text(path.with_suffix(".csv"), names, rows, head=head, encoding="utf-16")


def vectors_in_brackets(path: Path, one: Made) -> None:
    vectors = one.values.reshape(-1, 5, 3).tolist()
    lines = ["time;" + ";".join(f"finger{k}" for k in range(1, 6))]
    for t_s, row in zip(one.t_s, vectors, strict=True):
        lines.append(f"{t_s:.3f};" + ";".join(map(str, row)))
    path.with_suffix(".csv").write_text("\n".join(lines))


def millinewtons_with_commas(path: Path, one: Made) -> None:
    names = ["Zeit [ms]", *axes(5, "Finger {k} {axis} [mN]"), ""]
    rows = np.column_stack([1e3 * one.t_s + 5e6, 1e3 * one.values])
    write_text(
        path.with_suffix(".csv"), names, rows, separator=";", decimal=",", texts=[""] * len(rows),
        encoding="utf-8-sig", end="\r\n",
    )  # fmt: skip


def units_below_the_names(path: Path, one: Made) -> None:
    names = ["clock", *axes(5, "Finger {k} {axis}")]
    rows = np.column_stack([1e9 * one.t_s, one.values])
    units = ["ns", *["N"] * 15]
    write_text(
        path.with_suffix(".tsv"), units, rows, separator="\t", head="\t".join(names)
    )


def a_clock_and_its_milliseconds(path: Path, one: Made) -> None:
    form = "{h:02d}:{m:02d}:{s:02.0f}"
    first = [clock(CLOCK_S + int(t_s + 1e-9), form) for t_s in one.t_s]
    rows = np.column_stack([np.round(1e3 * one.t_s) % 1000, one.values])
    names = ["clock", "ms", *axes(5)]
    write_text(path.with_suffix(".csv"), names, rows, first=first)


def over_midnight(path: Path, one: Made) -> None:
    first = [clock(86_398.0 + t) for t in one.t_s]
    names = ["when", *axes(5, "B{axis}{k} [mT]")]
    write_text(path.with_suffix(".log"), names, 1e-3 * one.values, first=first)


def american_dates_over_midnight(path: Path, one: Made) -> None:
    begin = datetime(2024, 5, 3, 23, 59, 58)
    times = [begin + timedelta(seconds=t) for t in one.t_s.tolist()]
    first = [f"{at.month}/{at.day}/{at:%Y %I:%M:%S.%f %p}" for at in times]
    write_text(path.with_suffix(".csv"), ["when", *axes(5)], one.values, first=first)


def dates_of_matlab(path: Path, one: Made) -> None:
    begin = datetime(2024, 5, 1, 14, 2)
    times = [begin + timedelta(seconds=t) for t in one.t_s.tolist()]
    first = [f"{at:%d-%b-%Y %H:%M:%S.%f}" for at in times]
    write_text(path.with_suffix(".csv"), ["Time", *axes(5)], one.values, first=first)


def durations_of_matlab(path: Path, one: Made) -> None:
    first = [f"{t_s:.2f} sec" for t_s in one.t_s]
    write_text(path.with_suffix(".csv"), ["Time", *axes(5)], one.values, first=first)


def shear_and_normal(path: Path, one: Made) -> None:
    parts = ("shear1", "shear2", "normal")
    names = ["t", *(f"pad{k}_{part}" for k in range(1, 6) for part in parts)]
    write_log(path.with_suffix(".csv"), one, names=names)


def normals_last(path: Path, one: Made) -> None:
    by_axis = one.values.reshape(-1, 5, 3).transpose(0, 2, 1).reshape(-1, 15)
    names = ["t", *(f"ch{k}" for k in range(15))]
    write_log(path.with_suffix(".csv"), one, by_axis, names)


def sorted_as_text(path: Path, one: Made) -> None:
    order = sorted(range(1, 6), key=lambda k: str(9 + k))
    names = ["time_ms", *(f"taxel{8 + k}_F{a}" for k in order for a in "xyz")]
    columns = [3 * (k - 1) + a for k in order for a in range(3)]
    rows = np.column_stack([1e3 * one.t_s, one.values[:, columns]])
    write_text(path.with_suffix(".csv"), names, rows)


def bursts(path: Path, one: Made) -> None:
    """Eight rows at a time, a millisecond apart."""
    k = np.arange(len(one.t_s))
    t_ms = 80.0 * (k // 8) + 1.0 * (k % 8)
    write_text(
        path.with_suffix(".csv"), ["ms", *axes(5)], np.column_stack([t_ms, one.values])
    )


def whole_seconds(path: Path, one: Made) -> None:
    first = [clock(CLOCK_S + int(t), "{h:02d}:{m:02d}:{s:02.0f}") for t in one.t_s]
    write_text(path.with_suffix(".csv"), ["time", *axes(5)], one.values, first=first)


def a_file_for_each_finger(path: Path, one: Made) -> None:
    parts = np.split(one.values, 5, axis=1)
    for finger, part in zip(
        ("thumb", "index", "middle", "ring", "little"), parts, strict=True
    ):
        rows = np.column_stack([9.0 + one.t_s, part])
        place = path.with_name(f"{path.name}_{finger}.csv")
        write_text(place, ["time", "fx", "fy", "fz"], rows)


def two_tables_on_a_sheet(path: Path, one: Made) -> None:
    merged: list[object] = [
        "t (s)",
        *(cell for k in range(1, 6) for cell in (f"Pad {k}", None, None)),
    ]
    rows: list[list[object]] = [["Lab 7"], [], merged, [None, *"xyz" * 5]]
    for t_s, row in zip(one.t_s.tolist(), one.values.tolist(), strict=True):
        beside = [None, "mug", 198] if len(rows) == 6 else []
        rows.append([t_s, *row, *beside])
    write_sheet(path.with_suffix(".xlsx"), rows)


def names_and_millis_behind_a_stamp(path: Path, one: Made) -> None:
    first = [f"{clock(CLOCK_S + t)} -> {1e3 * t:.1f}" for t in one.t_s]
    names = [f"{clock(CLOCK_S)} -> ms", *axes(5)]
    write_text(path.with_suffix(".txt"), names, one.values, first=first)


def moments_beside_forces(path: Path, one: Made) -> None:
    names = ["t", *axes(5, "ft{k}_F{axis}"), *axes(5, "ft{k}_M{axis}")]
    write_log(path.with_suffix(".csv"), one, np.tile(one.values, 2), names)


def words_for_axes_that_nobody_knows(path: Path, one: Made) -> None:
    parts = ("Querkraft A", "Querkraft B", "Druck")
    names = ["t", *(f"Finger {k} {part}" for k in range(9, 14) for part in parts)]
    write_log(path.with_suffix(".csv"), one, names=names)


def seconds_and_nanoseconds(path: Path, one: Made) -> None:
    ns = np.round(1e9 * one.t_s).astype(int)
    rows = np.column_stack([1_700_000_000 + ns // 10**9, ns % 10**9, one.values])
    write_text(path.with_suffix(".csv"), ["stamp.sec", "stamp.nanosec", *axes(5)], rows)


def a_table_of_words_beside(path: Path, one: Made) -> None:
    shear_and_normal(path, one)
    path.with_name("persons.csv").write_text("name,hand\nanna,left\nben,right\n")
    path.with_name("gains.csv").write_text(
        "sensor,x,y,z\n1,1.0,1.0,1.1\n2,1.0,1.0,1.2\n"
    )


def quoted_commas_over_noon_until_a_power_cut(path: Path, one: Made) -> None:
    noon = datetime(2026, 11, 28, 12)
    first = [f'"{noon + timedelta(seconds=t - 2):%I:%M:%S.%f %p}' for t in one.t_s]
    place = write_text(
        path.with_suffix(".csv"),
        ['"time', *axes(5), 'end"'],
        one.values,
        separator='","',
        decimal=",",
        first=first,
        texts=['"'] * len(first),
    )
    place.write_bytes(place.read_bytes() + bytes(300))


def a_row_for_each_sensor(path: Path, one: Made) -> None:
    fingers = ("thumb", "index", "middle", "ring", "little")
    rows = np.column_stack([np.repeat(one.t_s, 5), one.values.reshape(-1, 3)])
    words = [*fingers] * len(one.t_s)
    write_text(path.with_suffix(".csv"), ["time", *"xyz", "finger"], rows, texts=words)


def a_row_for_each_value(path: Path, one: Made) -> None:
    rows = np.column_stack([np.tile(one.t_s, 15), one.values.T.ravel()])
    names = [name for name in axes(5) for _ in one.t_s]
    write_text(path.with_suffix(".csv"), ["t", "value", "channel"], rows, texts=names)


def lines_for_a_plotter(path: Path, one: Made) -> None:
    numbers = np.column_stack([1e3 * one.t_s, one.values]).tolist()
    names = ["t", *axes(5)]
    lines = [" ".join(map("{}:{:g}".format, names, row)) for row in numbers]
    path.with_suffix(".txt").write_text("\n".join(lines))


def a_rate_above_the_names(path: Path, one: Made) -> None:
    rows = np.column_stack([np.arange(len(one.t_s)), one.values])
    head = "Device: rig 7\nSampling rate: 100 Hz\nGain: 4\n\n"
    write_text(path.with_suffix(".csv"), ["index", *axes(5)], rows, head=head)


READINGS = {
    write.__name__: write
    for write in (
        serial_monitor, tabs_without_a_heading, utf16_with_comments,
        vectors_in_brackets, millinewtons_with_commas, units_below_the_names, over_midnight,
        shear_and_normal, sorted_as_text, bursts, whole_seconds,
        a_file_for_each_finger, two_tables_on_a_sheet, names_and_millis_behind_a_stamp,
        moments_beside_forces, words_for_axes_that_nobody_knows, seconds_and_nanoseconds,
        a_table_of_words_beside, quoted_commas_over_noon_until_a_power_cut, lines_for_a_plotter,
        a_rate_above_the_names,
        a_clock_and_its_milliseconds, american_dates_over_midnight, dates_of_matlab,
        durations_of_matlab,
    )
}  # fmt: skip


@pytest.mark.parametrize("form", READINGS)
def test_readings_of_any_form_are_the_same_trials_and_the_action_is_asked(
    run: Run, tmp_path: Path, form: str
) -> None:
    trials = [made(k) for k in (1, 2)]
    (tmp_path / "logs").mkdir()
    for k, one in enumerate(trials, 1):
        READINGS[form](tmp_path / f"logs/log{k}", one)
    assert "what happens in these trials?" in imported(run, tmp_path, code=2)
    out = imported(run, tmp_path, *SLIP)
    for k, one in enumerate(trials, 1):
        trial = read_trial(tmp_path / f"set/object/slip/trial_{k}.csv")
        np.testing.assert_allclose(trial.raw, one.values, atol=2e-4)
        np.testing.assert_allclose(trial.t_s, one.t_s, atol=0.02)
    assert "2 trials: 2 slip" in out
    # no guess is made in silence
    assert "hand       proposed, the first 1 on the thumb's side" in out
    assert ("stamps in bursts" in out) == (form in ("bursts", "whole_seconds"))
    code, out, _ = run("check", tmp_path / "set")
    assert code == 0, out
    # what was imported holds the map for the next time and for live runs
    kept = ("--map", tmp_path / "set/import.toml")
    assert "2 trials: 2 slip" in imported(run, tmp_path, *kept, out="again")


UNJOINED: dict[str, tuple[Callable[[Path, Made], None], str]] = {
    "a row for each sensor": (
        a_row_for_each_sensor,
        "each row of log is of one finger that comes in turn: write a row for each time",
    ),
    "a row for each value": (
        a_row_for_each_value,
        "which columns of log are x, y and z of each sensor? (t, value, channel)",
    ),
    "all x, then all y, then all z": (
        normals_last,
        "columns ch0, ch1, ch2, ch3, ch4, ch5, ch6, ch7 and 7 more of log: which are x, y and z",
    ),
}


@pytest.mark.parametrize("form", UNJOINED)
def test_readings_that_do_not_stand_by_sensors_are_asked(
    run: Run, tmp_path: Path, form: str
) -> None:
    write, question = UNJOINED[form]
    (tmp_path / "logs").mkdir()
    write(tmp_path / "logs/log", made(1))
    assert question in imported(run, tmp_path, *SLIP, code=2)


def test_columns_axis_by_axis_are_sensors_by_their_names(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    (tmp_path / "logs").mkdir()
    normals_last(tmp_path / "logs/log", one)
    given = ",".join(f"ch{k + 5 * axis}" for k in range(5) for axis in range(3))
    imported(run, tmp_path, *SLIP, "--sensors", given)
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    np.testing.assert_allclose(trial.raw, one.values)


# -- what marks the slip


def labelled(
    folder: Path, trials: Trials, words: Callable[[Made], list[str]], name: str
) -> None:
    """A column of labels beside the readings."""
    for k, one in enumerate(trials, 1):
        names = ["time_s", *axes(5), name]
        write_log(folder / f"logs/log{k}.csv", one, names=names, texts=words(one))


def sparse(one: Made, *words: str) -> list[str]:
    """A word only in the row where it begins."""
    cells = one.words(*words)
    before = ["", *cells[:-1]]
    return [
        cell if cell != was else "" for cell, was in zip(cells, before, strict=True)
    ]


def moment(one: Made) -> list[str]:
    """A mark in the row in which the slip begins."""
    begin = one.words("0", "0", "1").index("1")
    return ["1" if k == begin else "0" for k in range(len(one.t_s))]


COLUMNS: dict[str, tuple[str, Callable[[Made], list[str]]]] = {
    "binary": ("slip", lambda one: one.words("0", "0", "1")),
    "yes and no": ("is_slipping", lambda one: one.words("no", "no", "yes")),
    "a name that says no": ("no_slip", lambda one: one.words("1", "1", "0")),
    "words": ("phase", lambda one: one.words("open hand", "held", "SLIDING")),
    "camel case": ("state", lambda one: one.words("Idle", "GraspStable", "GrossSlip")),
    "sparse markers": (
        "marker",
        lambda one: sparse(one, "start_rest", "startGrasp", "start_slip"),
    ),
    "a contact beside it": (
        "contact,slip",
        lambda one: one.words("0,0", "1,0", "1,1"),
    ),
    "begins and ends": (
        "mark",
        lambda one: [
            {300: "slip_onset", 350: "slip_offset"}.get(k, "none") for k in range(500)
        ],
    ),
}


@pytest.mark.parametrize("form", COLUMNS)
def test_a_column_of_labels_says_when_it_slips(
    run: Run, tmp_path: Path, form: str
) -> None:
    name, words = COLUMNS[form]
    labelled(tmp_path, [made(1), made(2)], words, name)
    out = imported(run, tmp_path)
    assert "2 trials: 2 slip" in out
    for k in (1, 2):
        phases = phases_of(tmp_path / f"set/object/slip/trial_{k}.csv")
        grasps = [phase for phase in phases if phase[2] != "nothing"]
        assert [phase[2] for phase in grasps] == ["grasp", "risky_slip", "grasp"]
        assert grasps[0][0] == pytest.approx(1.0, abs=0.06)
        assert grasps[1][:2] == pytest.approx([3.0, 3.5])


def phases_of(trial: Path) -> list[tuple[float, float, str]]:
    truth = json.loads(trial.with_suffix(".truth.json").read_text())
    return [(p["t0_s"], p["t1_s"], p["label"]) for p in truth["phases"]]


def test_markers_at_the_ends_of_lines_of_tabs_are_labels(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    names, rows = ["t", *axes(5), "marker"], np.column_stack([one.t_s, one.values])
    texts = sparse(one, "rest", "grasp", "slip")
    write_text(tmp_path / "logs/a.tsv", names, rows, separator="\t", texts=texts)
    imported(run, tmp_path)
    phases = phases_of(tmp_path / "set/object/slip/trial_1.csv")
    assert (3.0, 3.5, "risky_slip") in phases


def test_trials_without_the_mark_of_a_slip_are_held(run: Run, tmp_path: Path) -> None:
    labelled(tmp_path, [made(1)], lambda one: one.words("0", "0", "1"), "slip")
    one = made(2)
    names = ["time_s", *axes(5), "slip"]
    write_log(tmp_path / "logs/log2.csv", one, names=names, texts=["0"] * len(one.t_s))
    out = imported(run, tmp_path)
    assert "2 trials: 1 slip, 1 hold" in out


def test_a_mark_in_one_row_lasts_to_the_end_of_the_touch(
    run: Run, tmp_path: Path
) -> None:
    labelled(tmp_path, [made(1)], moment, "slip_onset")
    out = imported(run, tmp_path)
    assert "to the end of the contact" in out
    *_, slip = phases_of(tmp_path / "set/object/slip/trial_1.csv")
    assert slip == (3.0, pytest.approx(4.0, abs=0.06), "risky_slip")


def test_a_mark_of_the_touch_alone_does_not_say_what_happens(
    run: Run, tmp_path: Path
) -> None:
    labelled(tmp_path, [made(1)], lambda one: one.words("0", "1", "1"), "on")
    assert "what happens in these trials?" in imported(run, tmp_path, code=2)


ASKED: dict[str, tuple[str, tuple[str, str, str], str]] = {
    "words of another language": (
        "zustand", ("offen", "halten", "slip"), "offen=nothing,halten=hold",
    ),
    "numbers": ("phase", ("0", "1", "2"), "1=hold,2=slip"),
    "a point and an S": ("event", (".", ".", "S"), "S=slip"),
    "true and false": ("label", ("False", "False", "True"), "1=slip"),
}  # fmt: skip


@pytest.mark.parametrize("form", ASKED)
def test_what_no_word_explains_is_asked_once(
    run: Run, tmp_path: Path, form: str
) -> None:
    name, words, answer = ASKED[form]
    labelled(tmp_path, [made(1), made(2)], lambda one: one.words(*words), name)
    asked = imported(run, tmp_path, code=2)
    for pair in answer.split(","):
        assert repr(pair.partition("=")[0]) in asked
    # what happens in all says nothing about when
    assert "what is " in imported(run, tmp_path, *SLIP, code=2)
    imported(run, tmp_path, "--action", answer)
    phases = phases_of(tmp_path / "set/object/slip/trial_1.csv")
    slips = [phase for phase in phases if "risky" in phase[2]]
    assert slips == [(3.0, 3.5, "risky_slip")]


def test_a_column_that_nothing_calls_a_label_is_named_and_can_be_answered(
    run: Run, tmp_path: Path
) -> None:
    labelled(tmp_path, [made(1)], lambda one: one.words("nein", "nein", "ja"), "flag")
    asked = imported(run, tmp_path, code=2)
    assert "not used   flag" in asked
    assert "what happens in these trials?" in asked
    imported(run, tmp_path, "--action", "ja=slip")
    phases = phases_of(tmp_path / "set/object/slip/trial_1.csv")
    assert (3.0, 3.5, "risky_slip") in phases


SHEETS = {
    "one for all, names of files": (
        "events.csv",
        "file;start;end;label\n{a};3.0;3.5;slip\n",
    ),
    "other words": ("ereignisse.csv", "datei;von;bis;was\n{a};3.0;3.5;slip\n"),
    "numbers of trials": (
        "events.csv",
        "trial;start_ms;end_ms;label\n{n};3000;3500;slip\n",
    ),
    "one beside each log": ("{a}_events.csv", "start,end,label\n3.0,3.5,slip\n"),
    "rows": ("notes.csv", "log,first row,last row,what\n{a},300,350,slips\n"),
    "durations": ("events.csv", "file,onset,duration,event\n{a},3,0.5,slip\n"),
    "on the clock": ("e.csv", "file,from,to,what\n{a},70003.0,70003.5,slip\n"),
    "a clock and labels alone": (
        "{a}_marks.csv",
        "time,what\n70001.0,grasp\n70003.0,slip\n70003.5,grasp\n",
    ),
    "no labels": ("slips.csv", "file,begin,end\n{a},3,3.5\n"),
    "a track of labels": ("{a}.txt", "0\t1\tzork\n3.0\t3.5\trisky slip\n"),
    "a track of points": ("{a}.txt", "1\t1\tgrasp\n3.0\t3.0\tslip\n3.5\t3.5\tgrasp\n"),
    "ends alone": ("e.csv", "file,at,what\n{a},1,grasp\n{a},3.0,slip\n{a},3.5,grasp\n"),
}


@pytest.mark.parametrize("form", SHEETS)
def test_a_table_of_events_says_when_it_slips(
    run: Run, tmp_path: Path, form: str
) -> None:
    names = ["mug_1", "mug_2"]
    for k, name in enumerate(names, 1):
        one = made(k)
        rows = np.column_stack([70_000.0 + one.t_s, one.values])
        write_text(tmp_path / f"logs/{name}.csv", ["time_s", *axes(5)], rows)
    file, text = SHEETS[form]
    head, *lines = text.splitlines(keepends=True)
    for name in names:
        here = tmp_path / "logs" / file.format(a=name)
        before = here.read_text() if here.exists() else head
        body = "".join(lines).format(a=name, n=name[-1])
        here.write_text(before + body)
    answer: tuple[str, ...] = ()
    if "zork" in text:
        assert "what is 'zork'" in imported(run, tmp_path, code=2)
        answer = ("--action", "zork=")
    out = imported(run, tmp_path, *answer)
    assert "2 trials: 2 slip" in out
    assert ("zork = none" in out) == ("zork" in text)
    (first, second) = sorted((tmp_path / "set").rglob("trial_?.csv"))
    for trial in (first, second):
        slips = [phase for phase in phases_of(trial) if phase[2] == "risky_slip"]
        assert slips == [(3.0, 3.5, "risky_slip")]


# -- trials and names


def in_one_file(
    folder: Path, trials: Trials, begins_s: list[float], **columns: list[str]
) -> None:
    rows, texts = [], []
    for k, one in enumerate(trials):
        rows.append(np.column_stack([begins_s[k] + one.t_s, one.values]))
        texts += [",".join(cells[k] for cells in columns.values())] * len(one.t_s)
    names = ["time_s", *axes(5), *columns]
    write_text(
        folder / "logs/all.csv",
        names,
        np.concatenate(rows),
        texts=texts if columns else None,
    )


MANY: dict[str, tuple[list[float], dict[str, list[str]]]] = {
    "a column": ([0.0, 5.0, 10.0], {"run": ["1", "2", "3"]}),
    "pauses": ([0.0, 9.0, 21.0], {}),
    "a clock that begins anew": ([0.0, 0.0, 0.0], {}),
    "a clock that jumps by hours": ([0.0, 7200.0, 14_500.0], {}),
}


@pytest.mark.parametrize("form", MANY)
def test_one_file_is_cut_into_its_trials(run: Run, tmp_path: Path, form: str) -> None:
    trials = [made(k) for k in (1, 2, 3)]
    begins_s, columns = MANY[form]
    in_one_file(tmp_path, trials, begins_s, **columns)
    out = imported(run, tmp_path, *SLIP)
    assert "3 trials: 3 slip" in out
    for k, one in enumerate(trials, 1):
        trial = read_trial(tmp_path / f"set/object/slip/trial_{k}.csv")
        np.testing.assert_allclose(trial.raw, one.values, atol=1e-9)


@pytest.mark.parametrize(
    ("heading", "other", "action"),
    [("condition", "no slip", "hold"), ("event", "pass", "pass")],
)
def test_columns_name_who_does_what(
    run: Run, tmp_path: Path, heading: str, other: str, action: str
) -> None:
    trials = [made(k) for k in (1, 2)]
    columns = {"run": ["1", "2"], "subject": ["anna", "ben"], heading: ["slip", other]}
    in_one_file(tmp_path, trials, [0.0, 5.0], **columns)
    imported(run, tmp_path)
    assert (tmp_path / "set/anna/object/slip/trial_1.csv").is_file()
    assert (tmp_path / f"set/ben/object/{action}/trial_1.csv").is_file()


PATHS = {
    "p01_mug_slip_3": ((), "p01/mug/slip"),
    # without its times a pull is known as a slip alone
    "sub-02/pull/run-4": ((), "sub-02/object/slip"),
    "handover 7": ((), "object/pass"),
    "Subject 7/Trial 1 slip": ((), "Subject-7/object/slip"),
    "participant_12/bottle/drop-1": ((), "participant_12/bottle/slip"),
    "p01-cup-no-slip-1": ((), "p01/cup/hold"),
    "grasp_glass_slip_01": ((), "glass/slip"),
    # full-glass and empty-glass are objects
    "slip_empty-glass": ((), "empty-glass/slip"),
    "slip-empty-glass": ((), "empty-glass/slip"),
    "p3/slip/cup": (("--action", "hold"), "p3/cup/hold"),
    "subject3/cup/dropped/01": ((), "subject3/cup/slip"),
    "anna_mug_rutschen": (
        ("--person", "anna", "--action", "rutschen=slip"),
        "anna/mug/slip",
    ),
    "mug": (("--person", "p07", "--object", "mug", "--action", "hold"), "p07/mug/hold"),
}


@pytest.mark.parametrize("path", PATHS)
def test_paths_and_answers_name_person_object_and_action(
    run: Run, tmp_path: Path, path: str
) -> None:
    answers, place = PATHS[path]
    one = made(1)
    write_log(tmp_path / f"logs/{path}.csv", one)
    out = imported(run, tmp_path, *answers)
    assert (tmp_path / f"set/{place}/trial_1.csv").is_file(), out


# -- what cannot be known is asked, and nothing is silently wrong


NORMALS = {
    "fsr": ("fsr{k}", 0.02),
    "A": ("A{k}", 0.0),
}


@pytest.mark.parametrize("form", NORMALS)
def test_normals_alone_are_no_sensors_of_three_axes(
    run: Run, tmp_path: Path, form: str
) -> None:
    name, noise = NORMALS[form]
    one = made(1, sensors=6)
    normals = np.abs(one.values[:, 2::3]) - noise
    names = ["t", *(name.format(k=k) for k in range(6))]
    write_log(tmp_path / "logs/a.csv", one, normals, names)
    out = imported(run, tmp_path, *SLIP, code=2)
    assert "of a: which are x, y and z of each sensor?" in out
    assert "the step needs shear" in out


def test_rows_of_sensors_that_no_time_joins_are_asked(run: Run, tmp_path: Path) -> None:
    one = made(1, sensors=1)
    sensors = np.random.default_rng(0).integers(1, 6, len(one.t_s))
    names = ["t", *"xyz", "sensor"]
    write_log(tmp_path / "logs/a.csv", one, names=names, texts=list(map(str, sensors)))
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "sensor that comes in turn" in asked


def test_names_again_within_a_file_are_one_note(run: Run, tmp_path: Path) -> None:
    one = made(1)
    path = write_log(tmp_path / "logs/a.csv", one)
    head, *lines = path.read_text().splitlines()
    path.write_text("\n".join([head, *lines[:300], head, *lines[300:]]))
    out = imported(run, tmp_path, *SLIP)
    assert re.findall("note .*", out) == [
        "note       a: 1 line without a number left out"
    ]
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    np.testing.assert_allclose(trial.raw, one.values)


def test_the_rate_is_asked_and_a_counter_is_a_clock_with_it(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    count = np.arange(len(one.t_s))
    there = (count < 150) | (count >= 170)
    rows = np.column_stack([count % 256, one.values])[there]
    write_text(tmp_path / "logs/a.csv", ["seq", *axes(5)], rows)
    out = imported(run, tmp_path, *SLIP, code=2)
    assert "how many rows a second" in out
    out = imported(run, tmp_path, *SLIP, "--rate", 100)
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    assert trial.t_s[-1] == pytest.approx(one.t_s[-1])
    assert np.isnan(trial.raw[150:170]).all()
    np.testing.assert_allclose(trial.raw[170:], one.values[170:])


def test_an_axis_that_contradicts_the_names_is_asked(run: Run, tmp_path: Path) -> None:
    one = made(1)
    turned = np.roll(one.values.reshape(-1, 5, 3), 1, axis=2).reshape(-1, 15)
    write_log(tmp_path / "logs/a.csv", one, turned)
    out = imported(run, tmp_path, *SLIP, code=2)
    assert "a touch moves x most, the names say z" in out
    out = imported(run, tmp_path, *SLIP, "--normal", "x")
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    np.testing.assert_allclose(trial.raw[:, 2::3], one.values[:, 2::3])


POLARITY = np.array([1.0, -1.0, 1.0, -1.0, -1.0])
SIGNS = {
    "tared": 0.0 * POLARITY,
    "counts above 0": 2048.0 + 0 * POLARITY,
    "magnets": 2048 * POLARITY,
}


@pytest.mark.parametrize("rest", SIGNS)
def test_a_press_raises_every_normal_whatever_the_polarity(
    run: Run, tmp_path: Path, rest: str
) -> None:
    one = made(1)
    rests, polarity = np.repeat(SIGNS[rest], 3), np.repeat(POLARITY, 3)
    counts = np.round(rests + 300.0 * polarity * one.values)
    write_log(tmp_path / "logs/a.csv", one, counts)
    imported(run, tmp_path, *SLIP, "--unit", "count")
    from holdfast.data.datasets import load

    (recording,) = load(tmp_path / "set", windows="none").recordings
    pressed = recording.samples[150:250, 2::3].mean(axis=0)
    np.testing.assert_allclose(pressed, 900.0, rtol=0.05)


def test_missing_cells_are_counted_and_gaps_become_lost_samples(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    path = write_log(tmp_path / "logs/a.csv", one)
    lines = path.read_text().splitlines()
    for k, word in ((40, "-"), (41, "n/a"), (42, ""), (43, "#N/A"), (44, "NaN")):
        cells = lines[k].split(",")
        lines[k] = ",".join([*cells[:4], word, *cells[5:]])
    path.write_text("\n".join([*lines[:200], *lines[220:]]))
    out = imported(run, tmp_path, *SLIP)
    assert "missing    samples of s2_x: 5" in out
    assert "gaps       1 of 0.21 to 0.21 s: lost samples" in out
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    assert np.flatnonzero(np.isnan(trial.raw[:, 3])).tolist() == [
        *range(39, 44),
        *range(199, 219),
    ]
    assert len(trial.t_s) == len(one.t_s)


@pytest.mark.parametrize(
    ("yes", "no"), [("1", "0"), ("1", "0.0"), ("1", "False"), ("true", "false")]
)
def test_readings_that_a_log_says_are_not_valid_are_missing(
    run: Run, tmp_path: Path, yes: str, no: str
) -> None:
    one = made(1)
    path = write_log(tmp_path / "logs/a.csv", one)
    head, *lines = path.read_text().splitlines()
    flags = ["valid1", "valid2", "valid3", "valid4", "valid5"]
    rows = [",".join([head, *flags])]
    for k, line in enumerate(lines):
        lost = 40 <= k < 45
        rows.append(",".join([line, yes, no if lost else yes, yes, yes, yes]))
    path.write_text("\n".join(rows))
    out = imported(run, tmp_path, *SLIP)
    assert "missing    samples of s2_x: 5, s2_y: 5, s2_z: 5" in out
    assert "not used" not in out
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    assert np.argwhere(np.isnan(trial.raw[:, 4])).ravel().tolist() == [*range(40, 45)]
    assert np.isfinite(trial.raw[:, [2, 8, 14]]).all()


def test_more_sensors_than_a_hand_has_are_said(run: Run, tmp_path: Path) -> None:
    one = made(1)
    rows = np.column_stack([one.t_s, one.values, one.values, one.values[:, :9]])
    names = ["t", *(f"{axis}{k}" for k in range(1, 14) for axis in "XYZ")]
    write_text(tmp_path / "logs/a.csv", names, rows)
    assert "13 sensors, and 12 are the most of a hand" in imported(run, tmp_path, *SLIP)


def test_a_sensor_that_sends_late_is_a_sensor(run: Run, tmp_path: Path) -> None:
    one = made(1)
    path = write_log(tmp_path / "logs/a.csv", one)
    head, *lines = [line.split(",") for line in path.read_text().splitlines()]
    for cells in lines[:300]:
        cells[1:4] = "---"
    path.write_text("\n".join(map(",".join, [head, *lines])) + "\n")
    out = imported(run, tmp_path, *SLIP)
    assert "missing    samples of s1_x: 300, s1_y: 300, s1_z: 300" in out
    assert read_trial(tmp_path / "set/object/slip/trial_1.csv").raw.shape[1] == 15


@pytest.mark.parametrize(("letter", "size"), [("G", 100.0), ("g", 0.00980665)])
def test_gauss_and_grams_are_two_units(
    run: Run, tmp_path: Path, letter: str, size: float
) -> None:
    one = made(1)
    names = ["t", *axes(5, "s{k}{axis} [" + letter + "]")]
    write_log(tmp_path / "logs/a.csv", one, names=names)
    imported(run, tmp_path, *SLIP)
    raw = read_trial(tmp_path / "set/object/slip/trial_1.csv").raw
    np.testing.assert_allclose(raw, size * one.values, atol=1e-6)


def test_trials_of_one_sensor_are_no_fingers(run: Run, tmp_path: Path) -> None:
    for k in (1, 2, 3):
        one = made(k, sensors=1)
        write_log(tmp_path / f"logs/slip{k}.csv", one)
    out = imported(run, tmp_path, *SLIP)
    assert "3 trials: 3 slip" in out


def test_a_sensor_that_no_touch_moves_is_asked_for_where_no_name_shows_it(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    one.values[:, 3:6] = 0.0
    write_text(tmp_path / "logs/a.csv", [], np.column_stack([one.t_s, one.values]))
    assert "--sensors" in imported(run, tmp_path, *SLIP, code=2)
    given = ",".join(f"column{k}" for k in range(2, 17))
    out = imported(run, tmp_path, *SLIP, "--sensors", given)
    assert "sensors    5, as given" in out


def test_sheets_of_the_same_columns_are_a_trial_each(run: Run, tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for k in (1, 2):
        one = made(k)
        sheet = book.create_sheet(f"Grasp {k}")
        sheet.append(["t (s)", *axes(5)])
        for row in np.column_stack([one.t_s, one.values]).tolist():
            sheet.append(row)
    (tmp_path / "logs").mkdir()
    book.save(tmp_path / "logs/all.xlsx")
    out = imported(run, tmp_path, *SLIP)
    assert "2 trials: 2 slip" in out


def test_columns_that_are_not_used_are_named(run: Run, tmp_path: Path) -> None:
    one = made(1)
    more = np.random.default_rng(0).normal(25.0, 1.0, (500, 4))
    rows = np.column_stack([one.t_s, one.values, more])
    names = ["t", *axes(5), "temperature", "imu_acc_x", "imu_acc_y", "imu_acc_z"]
    write_text(tmp_path / "logs/a.csv", names, rows)
    out = imported(run, tmp_path, *SLIP)
    assert "not used   temperature, imu_acc_x, imu_acc_y, imu_acc_z" in out


def test_a_changed_map_stays_and_one_that_nobody_changed_is_written_over(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    write_log(tmp_path / "logs/a.csv", one)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set")
    path = tmp_path / "set-map.toml"
    for _ in range(2):
        assert run(*words)[0] == 2
    text = path.read_text()
    path.write_text(text.replace("[time]", '[facts]\naction = "hold"\n\n[time]'))
    code, out, _ = run(*words)
    assert code == 2
    assert "was changed by hand" in out
    code, out, err = run(*words, "--map", path)
    assert code == 0, out + err
    assert "1 trial: 1 hold" in out


def test_an_import_ends_with_a_picture_and_the_words_of_check(
    run: Run, tmp_path: Path
) -> None:
    labelled(tmp_path, [made(1)], lambda one: one.words("0", "0", "1"), "slip")
    out = run("import", tmp_path / "logs", "--out", tmp_path / "set", "--yes")[1]
    picture = (tmp_path / "set/first-trial.svg").read_text("utf-8")
    assert re.search("grip, .*load, .*truth", picture, re.DOTALL)
    checked = run("check", tmp_path / "set")[1].splitlines()
    assert checked[0] in out
    assert checked[-1] in out


def test_two_hands_in_a_folder_are_not_one_set(run: Run, tmp_path: Path) -> None:
    for k, sensors in ((1, 5), (2, 4)):
        one = made(k, sensors)
        write_log(tmp_path / f"logs/a{k}.csv", one)
    out = imported(run, tmp_path, *SLIP, code=2)
    assert "4 sensors in N and 5 sensors in N: import each hand on its own" in out


UNCLEAR = {
    "mN": lambda one: 1e3 * one.values + 1364.2,
    # of the size of newtons
    "mT": lambda one: one.values + np.tile([1.1, -2.3, 7.2], 5),
    "gf": lambda one: 30.0 * one.values,
}


@pytest.mark.parametrize("unit", UNCLEAR)
def test_a_unit_that_sizes_do_not_tell_is_asked(
    run: Run, tmp_path: Path, unit: str
) -> None:
    one = made(1)
    write_log(tmp_path / "logs/a.csv", one, UNCLEAR[unit](one))
    out = imported(run, tmp_path, *SLIP, code=2)
    assert "what unit have the readings" in out
    out = imported(run, tmp_path, *SLIP, "--unit", "kg", code=2)
    assert "error: UsageError: --unit kg; next: one of N, mN, cN" in out
    imported(run, tmp_path, *SLIP, "--unit", unit)


def test_labels_that_begin_late_in_a_long_log_are_labels(
    run: Run, tmp_path: Path
) -> None:
    one = made(1, sensors=1, lasts_s=700.0)
    one.values[:, 2] += 3.0 * (one.t_s % 10.0 >= 6.0)
    slips = (one.t_s >= 667.0) & (one.t_s < 668.0)
    texts = np.where(slips, "1", "0").tolist()
    names = ["t", *"xyz", "slip_event"]
    write_log(tmp_path / "logs/a.csv", one, names=names, texts=texts)
    imported(run, tmp_path)
    phases = phases_of(tmp_path / "set/object/slip/trial_1.csv")
    slip = [phase for phase in phases if phase[2] == "risky_slip"]
    assert slip == [(pytest.approx(667.0), pytest.approx(668.0), "risky_slip")]


def test_a_word_that_a_map_does_not_know_is_never_passed_over(
    run: Run, tmp_path: Path
) -> None:
    words = ("import", tmp_path / "logs", "--out")
    labelled(tmp_path, [made(1)], moment, "slip_onset")
    assert run(*words, tmp_path / "set", "--yes")[0] == 0
    labelled(tmp_path, [made(1)], lambda one: one.words("0", "0", "7"), "slip_onset")
    code, _, err = run(*words, tmp_path / "new", "--map", tmp_path / "set/import.toml")
    assert code == 3
    assert "the label '7' is no situation" in err


@pytest.mark.parametrize("action", ["pass", "put-down"])
def test_an_action_without_its_times_is_one_that_check_takes(
    run: Run, tmp_path: Path, action: str
) -> None:
    one = made(1)
    write_log(tmp_path / "logs/a.csv", one)
    out = imported(run, tmp_path, "--action", action)
    assert "its times are not known" in out
    code, out, err = run("check", tmp_path / "set")
    assert code == 0, out + err
    from holdfast.data.datasets import load

    (recording,) = load(tmp_path / "set", windows="none").recordings
    assert {phase.situation for phase in recording.phases} == {0}


def test_words_that_may_be_people_are_asked_for_where_they_would_be_held_out(
    run: Run, tmp_path: Path
) -> None:
    for k, name in enumerate(("anna/1", "anna/2", "ben/1")):
        write_log(tmp_path / f"logs/{name}.csv", made(k))
    out = imported(run, tmp_path, *SLIP, code=2)
    assert "are anna, ben people or objects?" in out
    out = imported(run, tmp_path, *SLIP, "--person", "anna,ben")
    assert (tmp_path / "set/ben/object/slip/trial_1.csv").is_file()
