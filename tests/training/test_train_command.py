"""`holdfast train` without flags makes the plan of the shipped model, and says what it is about."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Run

from holdfast.data.datasets import load
from holdfast.data.fixture import write_fixture
from holdfast.training.plan import SLOW_PERMILLE, at_rate, hand_plan, pooled_plan

SIGNALLED = """
import os
import sys

from sklearn.neural_network import MLPClassifier

from holdfast.cli.main import main

step = MLPClassifier._backprop

def signalled(*given):
    os.kill(os.getpid(), int(sys.argv[1]))
    return step(*given)

MLPClassifier._backprop = signalled
raise SystemExit(main(sys.argv[2:]))
"""
"""The command line, which gets a signal at every step of a network's fit."""


@pytest.fixture(scope="module")
def fixture_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("train") / "set"
    write_fixture(folder, trials_per_cell=1)
    return folder


def test_train_without_flags_is_the_default_plan_on_balanced_windows(
    run: Run, fixture_set: Path, tmp_path: Path
) -> None:
    code, out, err = run("train", "--data", fixture_set, "--out", tmp_path / "out")
    assert code == 0, err
    made = json.loads((tmp_path / "out/artifact.json").read_text("utf-8"))
    plan = json.loads(json.dumps(hand_plan("default").to_json()))
    assert made["training"]["plan"] == plan
    assert made["decision"] == hand_plan("default").decision.to_json()
    dense = load(fixture_set, windows="balanced").tasks["classes"].class_counts()
    assert made["training"]["windows"] == {"classes": dense}
    lines = out.splitlines()
    assert any(
        re.match(r"held out by object: macro F1 over four situations  0\.\d{3}", one)
        for one in lines
    )
    assert f"classes: {sum(dense.values()):,} windows (nothing_light " in out
    # it ends with the file that `export` writes elsewhere
    model, elsewhere = tmp_path / "out/holdfast.onnx", tmp_path / "elsewhere.onnx"
    assert lines[-1] == (
        f"next: holdfast doctor {model}; "
        f"with a hand: holdfast run {model} --source usb://ft232h"
    )
    faster = "faster in C, where there is a compiler: holdfast export"
    assert f"{faster} {model} --to c --build" in lines
    (tmp_path / "elsewhere-c").mkdir()
    code, out, _ = run("export", tmp_path / "out", "--out", elsewhere)
    assert code == 0
    # the C form beside it is that of an earlier file
    assert out.splitlines()[-1] == f"{faster} {elsewhere} --to c --build --force"
    assert model.read_bytes() == elsewhere.read_bytes()


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, -signal.SIGTERM)]
)
def test_a_signal_while_a_network_is_fitted_ends_training_and_nothing_is_written(
    number: int, code: int, fixture_set: Path, tmp_path: Path
) -> None:
    words = ["train", "--data", fixture_set, "--out", tmp_path / "out"]
    words += ["--size", "tiny", "--learner", "network"]
    command = [sys.executable, "-c", SIGNALLED, str(int(number)), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert [*tmp_path.rglob("*")] == []


def test_pooled_features_of_slow_recordings_ask_for_less_confidence(
    run: Run, fixture_set: Path, tmp_path: Path
) -> None:
    words = ("train", "--data", fixture_set, "--out", tmp_path / "out")
    size = ("--size", "tiny", "--features", "pooled", "--learner", "forest")
    code, _, err = run(*words, *size)
    assert code == 0, err
    made = json.loads((tmp_path / "out/artifact.json").read_text("utf-8"))
    assert made["spec"]["rate_hz"] == pytest.approx(50.0)
    assert made["decision"]["min_risky_permille"] == SLOW_PERMILLE
    for untouched in (at_rate(pooled_plan("tiny"), 150.0), pooled_plan("tiny")):
        assert untouched.decision.min_risky_permille == 740
    assert at_rate(hand_plan("tiny"), 50.0) == hand_plan("tiny")
