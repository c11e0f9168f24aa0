"""A public set, rewritten as logs of another lab, from the import to a judged model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run
from foreign_logs import axes, write_text

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
    trial_path = own / "object/slip/trial_1.csv"
    code, out, err = run("replay", model / "holdfast.onnx", trial_path)
    assert code == 0, err
    assert len(out.splitlines()) == 300
