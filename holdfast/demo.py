"""`make demo`: no hardware, no data set: train on generated trials, export, and watch unseen trials go by."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.replay import open_replay
from edge_runtime.command import Parser, finish
from edge_runtime.contract import RISKY_SLIP, SAFE_SLIP, SITUATIONS, Prediction
from edge_runtime.monitor import GripMonitor, Model
from export.exporting import export_artifact
from holdfast.replay import ReplayClock
from training.datasets.thesis import load
from training.fitting import train
from training.fixture import write_fixture
from training.plan import TrainingPlan
from training.timeline import Phase, read_truth, truth_path

LETTERS = ".gsR"
"""nothing, grasp, safe slip, risky slip; a question mark is unknown."""
SHOWN = ("empty-bottle/pull", "full-bottle/fall", "basket-ball/pass")
COLUMN_S = 0.2


def run(folder: Path) -> int:
    """Train, export, and show three trials the model has never seen."""
    write_fixture(folder / "train", trials_per_cell=8, seed=0)
    write_fixture(folder / "unseen", trials_per_cell=1, seed=1)
    print("training on 121 generated trials (not recordings: this shows that it runs, not how good it is)")
    train(load(folder / "train"), folder / "model", TrainingPlan(), seed=0)
    path, report = export_artifact(folder / "model")
    checked = report["heads"]["situation"]
    print(f"exported {path.name}: {checked['rows']:,} rows checked, {checked['label_mismatches']} labels differ")
    model = Model(path)
    print(f"\none character = {COLUMN_S} s; . nothing, g grasp, s safe slip, R risky slip, ? unknown (settling)")
    for name in SHOWN:
        show(model, folder / "unseen" / name / "trial_1.csv", name)
    print("\nreal recordings: make real (needs HOLDFAST_DATA; holdfast doctor says what is there)")
    return 0


def show(model: Model, trial: Path, name: str) -> None:
    """Truth above, answer below, and how long after the slip began the hand would act."""
    source = open_replay(trial).prepared(model.card.preparation)
    t_s = source.t_ns / 1e9
    phases = read_truth(truth_path(trial), t_s)
    monitor = GripMonitor(model, ReplayClock())
    answers = [monitor.feed(sample) for sample in source]
    step = round(COLUMN_S * source.rate_hz)
    labels = np.concatenate([np.full(phase.stop - phase.first, phase.situation) for phase in phases])
    print(f"\n{name}")
    print("  was   " + "".join(LETTERS[k] for k in labels[step // 2 :: step]))
    print("  says  " + "".join(_letter(answer) for answer in answers[step // 2 :: step]))
    print("  " + _outcome(phases, answers, source.rate_hz))


def _letter(answer: Prediction) -> str:
    return "?" if answer.state == "unknown" else LETTERS[SITUATIONS.index(answer.state)]


def _outcome(phases: tuple[Phase, ...], answers: list[Prediction], rate_hz: float) -> str:
    acts = [index for index, answer in enumerate(answers) if answer.act]
    slips = [phase for phase in phases if phase.situation in (SAFE_SLIP, RISKY_SLIP)]
    if slips[0].situation == SAFE_SLIP:
        return f"a hand-over: the hand {'WOULD ACT (wrongly)' if acts else 'leaves it alone'}"
    if not acts:
        return "a slip, MISSED"
    delay_ms = 1000 * (acts[0] - slips[0].first) / rate_hz
    return f"a slip: the hand acts {delay_ms:+.0f} ms after it began (one sample is {1000 / rate_hz:.0f} ms)"


def main(argv: Sequence[str]) -> int:
    """Parse and run in a temporary folder, which is removed."""
    parser = Parser(prog="make demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        return run(Path(folder))


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
