"""The public sets, rewritten as logs of other labs, from the import to a judged model."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_line import Run
from foreign_logs import axes, write_sheet, write_text

from holdfast.core.trial_file import read_trial

SMALL = ("--size", "tiny", "--learner", "forest")


def eflesh_with_semicolons(real_set: Callable[[str], Path], logs: Path) -> np.ndarray:
    """Four slips and three holds, in five sensors: decimal comma, milliseconds, 100 Hz."""
    with np.load(real_set("eflesh_slip") / "eflesh_slip.npz") as archive:
        chosen = [0, 20, 40, 60, 88, 98, 108]
        fields, slips = archive["X"][chosen, :, :15], archive["y"][chosen]
    for k, (field, slip) in enumerate(zip(fields, slips, strict=True), 1):
        name = f"{'tug' if slip else 'still'}_{k}.csv"
        rows = np.column_stack([8e6 + 10.0 * np.arange(300), field])
        names = ["Zeit [ms]", *axes(5, "Mag{k} B{axis} [uT]")]
        write_text(logs / name, names, rows, separator=";", decimal=",")
    return fields


def test_eflesh_from_semicolons_to_a_judged_model(
    run: Run, real_set: Callable[[str], Path], tmp_path: Path
) -> None:
    fields = eflesh_with_semicolons(real_set, tmp_path / "logs")
    own = tmp_path / "set"
    code, out, err = run("import", tmp_path / "logs", "--out", own, "--yes")
    assert code == 0, out + err
    assert "7 trials: 3 hold, 4 slip" in out
    trial = read_trial(own / "object/slip/trial_1.csv")
    np.testing.assert_allclose(trial.raw, fields[0], rtol=1e-6)
    assert trial.rate_hz == pytest.approx(100.0)
    code, out, _ = run("check", own)
    assert (code, "ready for holdfast train" in out) == (0, True)
    model, report = tmp_path / "model", tmp_path / "r.html"
    words = ("train", "--data", own, "--out", model, *SMALL)
    code, out, err = run(*words, "--report", report)
    assert code == 0, err
    assert "held out by trial" in out
    assert "held out by trial" in report.read_text("utf-8").lower()
    assert run("export", model)[0] == 0
    trial_path = own / "object/slip/trial_1.csv"
    code, out, err = run("replay", model / "holdfast.onnx", trial_path)
    assert code == 0, err
    assert len(out.splitlines()) == 300


def human_slip_with_a_sheet(real_set: Callable[[str], Path], logs: Path) -> int:
    """Two people, three trials each: millinewtons, points and tabs, events in a sheet, in rows."""
    root = real_set("human_slip_uskin")
    with np.load(root / "signals.npz") as archive:
        starts = archive["offset"][:7]
        taxels = archive["xela"][: starts[-1], 12:30]
        turns = archive["object_imu"][: starts[-1], :4]
    rows: list[list[object]] = [["file", "first row", "last row", "what"]]
    for k, (first, stop) in enumerate(pairwise(starts.tolist())):
        name = f"s{k // 3 + 1}_book_{k % 3 + 1}"
        t_us = np.round(1e6 * np.arange(stop - first) / 58.9)
        table = np.column_stack([t_us, 1e3 * taxels[first:stop]])
        names = ["t_us", *axes(6, "t{k}{axis}_mN")]
        path = logs / f"{name}.txt"
        write_text(path, names, table, separator="\t", head="# rig 2")
        words = rotations(turns[first:stop], taxels[first:stop, 2::3].sum(axis=1))
        begins = [
            0,
            *(np.flatnonzero(words[1:] != words[:-1]) + 1).tolist(),
            len(words),
        ]
        rows += [[name, a, b, words[a]] for a, b in pairwise(begins)]
    write_sheet(logs / "events.xlsx", rows)
    return len(starts) - 1


def rotations(turns: np.ndarray, load_n: np.ndarray) -> np.ndarray:
    """A word for each row, by how far the object has turned since the middle of the hold."""
    unit = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    turned = 2.0 * np.degrees(np.arccos(np.clip(np.abs(unit @ unit[500]), 0.0, 1.0)))
    load_n = load_n - np.median(load_n[:60])
    what = np.where(turned < 15.0, "small rotation", "slips")
    what = np.where(turned < 5.0, "stable grip", what)
    return np.where(load_n < 1.0, "hand open", what)


def test_human_slip_from_microseconds_and_a_sheet_to_a_model(
    run: Run, real_set: Callable[[str], Path], tmp_path: Path
) -> None:
    count = human_slip_with_a_sheet(real_set, tmp_path / "logs")
    own = tmp_path / "set"
    words = ("import", tmp_path / "logs", "--out", own, "--yes")
    # what nobody can know is said on the command line
    code, out, err = run(*words, "--action", "small rotation=pass")
    assert code == 0, out + err
    assert "mN, by the names" in out
    assert f"{count} trials" in out
    code, out, _ = run("check", own)
    assert code == 0, out
    assert "held out by person: 2 people" in out
    model = tmp_path / "model"
    code, out, err = run("train", "--data", own, "--out", model, *SMALL)
    assert code == 0, err
    assert "held out by person" in out


def test_proactive_slip_from_one_long_table_with_a_column_of_labels(
    run: Run, real_set: Callable[[str], Path], tmp_path: Path
) -> None:
    """Counts of five taxels, all trials in one file, with a word for each row."""
    root = real_set("proactive_slip_uskin") / "data_set"
    tables, words, at_s = [], [], 0.0
    for k, place in enumerate(sorted(root.iterdir()), 1):
        taxels = np.loadtxt(place / "xela_sensor1.csv", delimiter=",", skiprows=1)
        labels = np.loadtxt(place / "slip_label.csv", delimiter=",", skiprows=1)
        t_s = at_s + np.arange(len(taxels)) / 60.0
        at_s = t_s[-1] + 1.0
        run_number = np.full(len(t_s), float(k))
        tables.append(np.column_stack([t_s, run_number, taxels[:, :15]]))
        words += ["fail" if f else "slip" if s else "stable" for s, f in labels[:, :2]]
    path = tmp_path / "all.csv"
    names = ["seconds", "run", *axes(5, "txl{k}_{axis}"), "state"]
    write_text(path, names, np.concatenate(tables), separator="|", texts=words)
    own = tmp_path / "set"
    code, out, err = run("import", path, "--out", own, "--yes")
    assert code == 0, out + err
    assert "unit       count" in out
    trials = sorted(own.rglob("trial_?.csv"))
    assert len(trials) == 7
    np.testing.assert_allclose(read_trial(trials[0]).raw, tables[0][:, 2:])
    slips = 0
    for trial in trials:
        truth = json.loads(trial.with_suffix(".truth.json").read_text())["phases"]
        slips += {"grasp", "risky_slip"} == {phase["label"] for phase in truth}
    assert slips == 3
    code, out, _ = run("check", own)
    assert code == 0, out
