"""`python -m benchmarks hand-files`: the same learner behind three steps, timed in one run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import small_model
from page_tables import filled

from benchmarks import hand_files
from benchmarks.__main__ import main
from benchmarks.timed_calls import FLOOR
from holdfast.core.hand_card import hand_of_counts
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.export.again import for_hand


@pytest.fixture(scope="module")
def pooled() -> bytes:
    """A small file of six sensors with pooled features."""
    made = small_model.artifact(
        small_model.spec(("pooled_state", "pooled_shear"), n_sensors=6)
    )
    card = small_model.model_card(made)
    return small_model.seal(small_model.graph_of(made), card, made.spec)


def test_a_padded_file_takes_an_empty_slot_for_a_dead_finger(pooled: bytes) -> None:
    """Four of ten opposing slots stand in for all ten: the hand seems to grip twice as hard."""
    hand = hand_of_counts()
    _, six = for_hand(pooled, hand)
    _, twelve = for_hand(pooled, hand_files.padded(hand))
    values = np.zeros((30, 36))
    values[:, 2:18:3] = 2.0
    valid = np.zeros((30, 12), np.bool_)
    valid[:, :6] = True
    few = run_recording(open_session(six), values[:, :18], valid[:, :6], ["features"])
    many = run_recording(open_session(twelve), values, valid, ["features"])
    grip_n = [one["features"][-1, 0] for one in (few, many)]
    assert grip_n == pytest.approx([2 * 2.0 + 4 * 2.0, 2 * 2.0 + 10 * 2.0])


def test_all_files_are_timed_in_one_run(
    pooled: bytes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(hand_files.step_times, "__defaults__", (None, 1, 3))
    monkeypatch.setattr(hand_files, "TRIALS", 2)
    path = tmp_path / "pooled.onnx"
    path.write_bytes(pooled)
    words = ["--model", str(path), "--older", str(path), "--out", str(tmp_path)]
    assert main(["hand-files", *words]) == 0
    figures = json.loads((tmp_path / "hand-files.json").read_text("utf-8"))
    names = [row["file"] for row in figures["rows"]]
    shown = [hand_files.GIVEN, hand_files.SIX, hand_files.TWELVE, hand_files.OLDER]
    assert names == [*shown, FLOOR]
    assert figures["rows"][0]["over_first"] == 1.0
    for row in figures["rows"]:
        # Six sensors of twelve are too few; behind every other file the learner is the same.
        said = {FLOOR: None, hand_files.TWELVE: 0.0}.get(row["file"], 1.0)
        assert (row["answered"], row["same"]) == (said, said)
    page = filled("docs/hand.md", {"files": figures}, tmp_path)
    assert f"| {hand_files.TWELVE} |" in page
    assert hand_files.SIX in capsys.readouterr().out
