"""`make demo`: no hardware, no data set: simulate, train, export, and watch trials go by that the model never met."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_runtime.command import Parser, finish, path_argument
from edge_runtime.contract import SITUATIONS, Prediction, Sample
from edge_runtime.decision import UNKNOWN
from edge_runtime.monitor import GripMonitor, Model
from edge_runtime.writing import require_writable
from evaluation.streams import StreamPicture, picture_of
from export.exporting import export_artifact
from simulation.card import read_card
from simulation.folder import write_recording, write_set
from simulation.scene import Scene
from studies.scenes.report import demo_report
from training.datasets.thesis import load
from training.fitting import train, versions
from training.plan import TrainingPlan
from training.recording import Recording

RATE_HZ = 150.0
TRIALS = 240
TRAINED_SEED, UNSEEN_SEED = 0, 1
LETTERS = ".gsR"
"""nothing, grasp, safe slip, risky slip; a question mark is unknown."""
SHOWN = (("empty-bottle", "pull"), ("full-bottle", "fall"), ("basket-ball", "pass"))
COLUMN_S = 0.2


def run(out: Path, work: Path) -> int:
    """Train, export, show three trials the model has never seen, and leave model and report in out."""
    print(f"simulating {TRIALS} trials of the thesis' protocol at {RATE_HZ:g} Hz (simulated: no recording)")
    card = read_card("thesis", rate_hz=RATE_HZ)
    write_set(Scene(card, TRAINED_SEED), work / "train", TRIALS)
    data = load(work / "train")
    trained = train(data, work / "model", TrainingPlan(), seed=0)
    print(f"macro F1 over four situations, trials held out: {trained.figures['situations']['macro_f1']:.2f}")
    path, verified = export_artifact(work / "model", out / "holdfast.onnx")
    checked = verified["heads"]["situation"]
    print(f"exported {path}: {checked['rows']:,} rows checked, {checked['label_mismatches']} labels differ")
    print(f"\none character = {COLUMN_S} s; . nothing, g grasp, s safe slip, R risky slip, ? unknown (settling)")
    write_shown(Scene(card, UNSEEN_SEED), work / "unseen")
    model = Model(path)
    pictures = [watch(model, work / "unseen", one) for one in load(work / "unseen", windows="natural").recordings]
    for picture in pictures:
        show(picture)
    about = {"seed": 0, "versions": versions(), "command": "make demo"}
    print(f"\nreport: {demo_report(out / 'report.html', data, trained.held_out, about, pictures)}")
    print("real recordings: make real (needs HOLDFAST_DATA; holdfast doctor says what is there)")
    return 0


def write_shown(scene: Scene, folder: Path) -> None:
    """Simulate the first trial of each object and action to be shown, as the folders of a set."""
    trials = scene.trials(TRIALS)
    chosen = [next(t for t in trials if (t.thing.name, t.action) == shown) for shown in SHOWN]
    for told in scene.run_together(chosen):
        write_recording(folder / told.trial.thing.name / told.trial.action / "trial_1", scene, [told])


def watch(model: Model, folder: Path, recording: Recording) -> StreamPicture:
    """Feed a trial to the edge runtime sample by sample."""
    monitor = GripMonitor(model, None)
    t_ns = np.round(1e9 * np.arange(len(recording.samples)) / recording.rate_hz).astype(np.int64).tolist()
    samples = zip(t_ns, recording.samples, recording.valid, strict=True)
    answers = [monitor.feed(Sample(t, row, valid, k)) for k, (t, row, valid) in enumerate(samples)]
    acts = np.array([answer.act for answer in answers])
    return picture_of(folder, recording, np.array([_situation(answer) for answer in answers]), acts)


def _situation(answer: Prediction) -> int:
    return SITUATIONS.index(answer.state) if answer.state in SITUATIONS else UNKNOWN


def show(picture: StreamPicture) -> None:
    """Truth above, answer below, and how long after the load came on the hand would act."""
    recording = picture.recording
    was = np.repeat([phase.situation for phase in picture.phases], [p.stop - p.first for p in picture.phases])
    step = round(COLUMN_S * recording.rate_hz)
    print(f"\n{recording.object_name}/{recording.action}")
    for name, states in (("was ", was), ("says", picture.answer)):
        print(f"  {name}  " + "".join(_letter(states[k : k + step]) for k in range(0, len(states), step)))
    print("  " + _outcome(picture))


def _letter(states: npt.NDArray[np.int64]) -> str:
    """The gravest state of a column, since a slip can be shorter than one."""
    gravest = int(np.max(states))
    return "?" if gravest == UNKNOWN else LETTERS[gravest]


def _outcome(picture: StreamPicture) -> str:
    rate_hz = picture.recording.rate_hz
    acts_s = np.flatnonzero(picture.acts) / rate_hz
    if picture.recording.action == "pass":
        return f"a hand-over: the hand {'WOULD ACT (wrongly)' if len(acts_s) else 'leaves it alone'}"
    onset_s, gross_s = picture.events["load_onset_s"], picture.events["gross_slip_s"]
    slipped = f"all fingers slide {1e3 * (gross_s - onset_s):.0f} ms after the load came on"
    early = f"; WRONGLY asks before, at {acts_s[0]:.1f} s" if len(acts_s) and acts_s[0] < onset_s else ""
    after_s = acts_s[acts_s >= onset_s]
    if not len(after_s):
        return f"{slipped}; the slip is MISSED{early}"
    wait_ms, late = 1e3 * (after_s[0] - onset_s), "" if after_s[0] <= gross_s else "LATE, "
    return f"{slipped}; the hand acts {late}after {wait_ms:.0f} ms (a sample is {1e3 / rate_hz:.0f} ms){early}"


def main(argv: Sequence[str]) -> int:
    """Parse and run; what is simulated goes into a temporary folder, which is removed."""
    parser = Parser(prog="make demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=path_argument, default=Path("build/demo"), metavar="DIR", help="default build/demo"
    )
    args = parser.parse_args(argv)
    require_writable(args.out)
    with tempfile.TemporaryDirectory() as work:
        return run(args.out, Path(work))


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
