"""`make demo`: no hardware, no data set: simulate, train, export, and watch trials go by that the model never met."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from edge_runtime.command import Parser, finish
from edge_runtime.contract import RISKY_SLIP, SAFE_SLIP, SITUATIONS, Prediction, Sample
from edge_runtime.monitor import GripMonitor, Model
from export.exporting import export_artifact
from holdfast.replay import ReplayClock
from simulation.card import read_card
from simulation.folder import write_set
from simulation.scene import Scene, Told
from training.datasets.thesis import load
from training.fitting import train
from training.plan import TrainingPlan

RATE_HZ = 150.0
TRIALS = 240
TRAINED_SEED, UNSEEN_SEED = 0, 1
LETTERS = ".gsR"
"""nothing, grasp, safe slip, risky slip; a question mark is unknown."""
SHOWN = (("empty-bottle", "pull"), ("full-bottle", "fall"), ("basket-ball", "pass"))
COLUMN_S = 0.2


def run(folder: Path) -> int:
    """Train, export, and show three trials the model has never seen."""
    print(f"simulating {TRIALS} trials of the thesis' protocol at {RATE_HZ:g} Hz (simulated: no recording)")
    card = read_card("thesis", rate_hz=RATE_HZ)
    write_set(Scene(card, TRAINED_SEED), folder / "train", TRIALS)
    figures = train(load(folder / "train"), folder / "model", TrainingPlan(), seed=0)["situations"]
    print(f"macro F1 over four situations, trials held out: {figures['macro_f1']:.2f}")
    path, report = export_artifact(folder / "model")
    checked = report["heads"]["situation"]
    print(f"exported {path.name}: {checked['rows']:,} rows checked, {checked['label_mismatches']} labels differ")
    model = Model(path)
    print(f"\none character = {COLUMN_S} s; . nothing, g grasp, s safe slip, R risky slip, ? unknown (settling)")
    unseen = Scene(card, UNSEEN_SEED)
    trials = unseen.trials(TRIALS)
    chosen = [next(t for t in trials if (t.thing.name, t.action) == shown) for shown in SHOWN]
    for told in unseen.run_together(chosen):
        show(model, told)
    print("\nreal recordings: make real (needs HOLDFAST_DATA; holdfast doctor says what is there)")
    return 0


def show(model: Model, told: Told) -> None:
    """Truth above, answer below, and how long after the load came on the hand would act."""
    monitor = GripMonitor(model, ReplayClock())
    t_s = told.signal.t_s
    values = model.card.preparation.apply(told.signal.values.reshape(len(t_s), -1))
    samples = zip(t_s, values, told.signal.valid, strict=True)
    answers = [monitor.feed(Sample(round(t * 1e9), row, valid, k)) for k, (t, row, valid) in enumerate(samples)]
    starts = [since for since, _ in told.truth.marks]
    labels = [told.truth.marks[k][1] for k in np.searchsorted(starts, t_s, side="right") - 1]
    columns = [slice(k, k + round(COLUMN_S * RATE_HZ)) for k in range(0, len(t_s), round(COLUMN_S * RATE_HZ))]
    print(f"\n{told.trial.thing.name}/{told.trial.action}")
    print("  was   " + "".join(LETTERS[max(labels[column])] for column in columns))
    print("  says  " + "".join(_letter(answers[column]) for column in columns))
    print("  " + _outcome(told, answers))


def _letter(answers: Sequence[Prediction]) -> str:
    """The gravest state of a column, since a slip can be shorter than one."""
    states = {answer.state for answer in answers}
    return next((LETTERS[k] for k in (RISKY_SLIP, SAFE_SLIP, 1, 0) if SITUATIONS[k] in states), "?")


def _outcome(told: Told, answers: list[Prediction]) -> str:
    acts = [told.signal.t_s[index] for index, answer in enumerate(answers) if answer.act]
    if told.trial.action == "pass":
        return f"a hand-over: the hand {'WOULD ACT (wrongly)' if acts else 'leaves it alone'}"
    onset_s, gross_s = told.truth.load_onset_s or 0.0, told.truth.gross_slip_s or 0.0
    slipped = f"all fingers slide {1e3 * (gross_s - onset_s):.0f} ms after the load came on"
    after = [t for t in acts if t >= onset_s]
    if not after:
        return f"{slipped}; the slip is MISSED"
    return f"{slipped}; the hand acts after {1e3 * (after[0] - onset_s):.0f} ms (a sample is {1e3 / RATE_HZ:.0f} ms)"


def main(argv: Sequence[str]) -> int:
    """Parse and run in a temporary folder, which is removed."""
    parser = Parser(prog="make demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        return run(Path(folder))


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
