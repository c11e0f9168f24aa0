"""`holdfast import` of logs in the forms that people have: what went in comes out, or is asked."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run
from foreign_logs import Made, axes, made, write_sheet, write_text

from holdfast.core.trial_file import read_trial

Trials = list[Made]
CLOCK_S = 50_531.0
"""14:02:11, in s from midnight."""


def clock(t_s: float, form: str = "{h:02d}:{m:02d}:{s:06.3f}") -> str:
    """A time of day."""
    minutes, seconds = divmod(round(t_s % 86_400, 6), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return form.format(h=hours, m=minutes, s=seconds)


def names_of(count: int, form: str = "log{k}") -> list[str]:
    return [form.format(k=k) for k in range(1, count + 1)]


# -- readings of any form; nothing says what happens in them


def serial_monitor(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        lines = []
        for t_s, row in zip(one.t_s, one.values.tolist(), strict=True):
            numbers = ",".join(map(str, row))
            lines.append(f"{clock(CLOCK_S + t_s)} -> {numbers}\n")
        (logs / f"{name}.txt").write_text("".join(lines))


def serial_plotter(logs: Path, trials: Trials) -> None:
    names = ["t_ms", *axes(5)]
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        rows = np.column_stack([1e3 * one.t_s, one.values]).tolist()
        cells = [" ".join(f"{n}:{x:.10g}" for n, x in zip(names, row, strict=True)) for row in rows]
        (logs / name).write_text("\n".join(cells))


def tabs_without_a_heading(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        rows = np.column_stack([one.t_s, one.values])
        write_text(logs / f"{name}.dat", [], rows, separator="\t")


def utf16_with_comments(logs: Path, trials: Trials) -> None:
    head = "# made by a rig\n# 2024, 15 channels"
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        rows = np.column_stack([1e6 * one.t_s, one.values])
        names = ["# t_us", *axes(5, "F{k}{axis}")]
        write_text(logs / f"{name}.csv", names, rows, head=head, encoding="utf-16")


def vectors_in_brackets(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        vectors = one.values.reshape(-1, 5, 3).tolist()
        lines = ["time;" + ";".join(f"finger{k}" for k in range(1, 6))]
        for t_s, row in zip(one.t_s, vectors, strict=True):
            lines.append(f"{t_s:.3f};" + ";".join(map(str, row)))
        (logs / f"{name}.csv").write_text("\n".join(lines))


def millinewtons_with_commas(logs: Path, trials: Trials) -> None:
    names = ["Zeit [ms]", *axes(5, "Finger {k} {axis} [mN]"), ""]
    for name, one in zip(names_of(len(trials), "Messung {k}"), trials, strict=True):
        rows = np.column_stack([1e3 * one.t_s + 5e6, 1e3 * one.values])
        write_text(
            logs / f"{name}.csv", names, rows, separator=";", decimal=",", texts=[""] * len(rows),
            encoding="utf-8-sig", end="\r\n",
        )  # fmt: skip


def units_below_the_names(logs: Path, trials: Trials) -> None:
    names = ["clock", *axes(5, "Finger {k} {axis}")]
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        rows = np.column_stack([1e9 * one.t_s, one.values])
        units = ["ns", *["N"] * 15]
        write_text(logs / f"{name}.tsv", units, rows, separator="\t", head="\t".join(names))


def over_midnight(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        first = [clock(86_398.0 + t) for t in one.t_s]
        names = ["when", *axes(5, "B{axis}{k} [mT]")]
        write_text(logs / f"{name}.log", names, 1e-3 * one.values, first=first)


def shear_and_normal(logs: Path, trials: Trials) -> None:
    names = ["t", *(f"pad{k}_{part}" for k in range(1, 6) for part in ("shear1", "shear2", "normal"))]
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        write_text(logs / f"{name}.csv", names, np.column_stack([one.t_s, one.values]))


def normals_last(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        by_axis = one.values.reshape(-1, 5, 3).transpose(0, 2, 1).reshape(-1, 15)
        names = ["t", *(f"ch{k}" for k in range(15))]
        write_text(logs / f"{name}.csv", names, np.column_stack([one.t_s, by_axis]))


def sorted_as_text(logs: Path, trials: Trials) -> None:
    order = sorted(range(1, 6), key=lambda k: str(9 + k))
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        names = ["time_ms", *(f"taxel{8 + k}_F{a}" for k in order for a in "xyz")]
        columns = [3 * (k - 1) + a for k in order for a in range(3)]
        rows = np.column_stack([1e3 * one.t_s, one.values[:, columns]])
        write_text(logs / f"{name}.csv", names, rows)


def bursts(logs: Path, trials: Trials) -> None:
    """Eight rows at a time, a millisecond apart."""
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        k = np.arange(len(one.t_s))
        t_ms = 80.0 * (k // 8) + 1.0 * (k % 8)
        write_text(logs / f"{name}.csv", ["ms", *axes(5)], np.column_stack([t_ms, one.values]))


def whole_seconds(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        first = [clock(CLOCK_S + int(t), "{h:02d}:{m:02d}:{s:02.0f}") for t in one.t_s]
        write_text(logs / f"{name}.csv", ["time", *axes(5)], one.values, first=first)


def a_file_for_each_finger(logs: Path, trials: Trials) -> None:
    for k, one in enumerate(trials, 1):
        for f, finger in enumerate(("index", "little", "middle", "ring", "thumb")):
            place = (1, 4, 2, 3, 0)[f]
            part = one.values[:, 3 * place : 3 * place + 3]
            rows = np.column_stack([9.0 + one.t_s, part])
            write_text(logs / f"rec{k}_{finger}.csv", ["time", "fx", "fy", "fz"], rows)


def two_tables_on_a_sheet(logs: Path, trials: Trials) -> None:
    for name, one in zip(names_of(len(trials)), trials, strict=True):
        merged = ["t (s)", *(cell for k in range(1, 6) for cell in (f"Pad {k}", None, None))]
        rows: list[list[object]] = [["Lab 7"], [], merged, [None, *"xyz" * 5]]
        for t_s, row in zip(one.t_s.tolist(), one.values.tolist(), strict=True):
            beside = [None, "mug", 198] if len(rows) == 6 else []
            rows.append([t_s, *row, *beside])
        write_sheet(logs / f"{name}.xlsx", rows)


READINGS = {
    write.__name__: write
    for write in (
        serial_monitor, serial_plotter, tabs_without_a_heading, utf16_with_comments,
        vectors_in_brackets, millinewtons_with_commas, units_below_the_names, over_midnight,
        shear_and_normal, normals_last, sorted_as_text, bursts, whole_seconds,
        a_file_for_each_finger, two_tables_on_a_sheet,
    )
}  # fmt: skip


@pytest.mark.parametrize("form", READINGS)
def test_readings_of_any_form_are_the_same_trials_and_the_action_is_asked(
    run: Run, tmp_path: Path, form: str
) -> None:
    trials = [made(k) for k in (1, 2)]
    (tmp_path / "logs").mkdir()
    READINGS[form](tmp_path / "logs", trials)
    words = ("import", tmp_path / "logs", "--out", tmp_path / "set", "--yes")
    code, out, _ = run(*words)
    assert code == 2, out
    assert "question: what happens in these trials?" in out
    assert not (tmp_path / "set").exists()
    code, out, err = run(*words, "--action", "slip")
    assert code == 0, out + err
    for k, one in enumerate(trials, 1):
        trial = read_trial(tmp_path / f"set/object/slip/trial_{k}.csv")
        np.testing.assert_allclose(trial.raw, one.values, atol=2e-4)
        np.testing.assert_allclose(trial.t_s, one.t_s, atol=0.02)
    assert "2 trials: 2 slip" in out
    code, out, _ = run("check", tmp_path / "set")
    assert code == 0, out
