"""Answers as a data frame."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from holdfast import evaluation
from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.data.datasets import load
from holdfast.edge_runtime.monitor import Model

if TYPE_CHECKING:
    from conftest import Built

TRIALS = ("soft-ball/pull/trial_1", "hard-ball/fall/trial_1", "soft-ball/pass/trial_1")


@pytest.fixture(scope="module")
def few(eight_classes: Built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("few")
    for trial in TRIALS:
        (root / trial).parent.mkdir(parents=True)
        for suffix in (".csv", ".truth.json"):
            shutil.copy(
                f"{eight_classes.fixture / trial}{suffix}", f"{root / trial}{suffix}"
            )
    return root


def test_answers_have_a_line_a_sample_with_truth_and_state(
    eight_classes: Built, few: Path
) -> None:
    data = load(few, windows="natural")
    frame = evaluation.to_frame(evaluation.run_model(Model(eight_classes.model), data))
    assert len(frame) == sum(len(one.samples) for one in data.recordings)
    assert set(frame["trial_id"]) == set(TRIALS)
    pull = frame[frame["trial_id"] == TRIALS[0]]
    assert (set(pull["object"]), set(pull["action"])) == ({"soft-ball"}, {"pull"})
    assert pull["t_s"].iloc[50] == pytest.approx(1.0)
    (event,) = next(one for one in data.recordings if one.action == "pull").events
    risky_s = pull.loc[pull["truth"] == "risky_slip", "t_s"]
    assert risky_s.min() == pytest.approx(event.onset_s, abs=0.02)
    assert pull["state"].iloc[0] == "unknown"
    assert set(frame["state"]) <= {"unknown", *SITUATIONS}
    assert set(frame["class"].dropna()) <= set(CLASSES)
    settled = pull[pull["state"] != "unknown"]
    sums = settled[[f"p_{name}" for name in SITUATIONS]].sum(axis=1)
    np.testing.assert_allclose(sums, 1.0, atol=1e-5)
    assert (settled["state"] == settled["truth"]).mean() > 0.8
    assert settled["risky_share"].between(0, 1).all()
