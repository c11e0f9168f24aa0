"""`python -m studies hands`: one learner on hands of 2, 3, 6 and 12 sensors, not trained again.

The same trials on every hand (objects, people, forces), the same learner behind a step of each hand
card. Open loop: slips found, in time, voluntary actions called. Closed loop: preventable drops that
the grip commands save, and hand-overs that they block. Seed 7001 is locked; take 100 to 199 to
choose anything.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from holdfast.cli.command import path_argument
from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.hand_card import read_hand_card
from holdfast.core.reading import Json, model_path
from holdfast.core.writing import require_writable, write_whole
from holdfast.edge_runtime.c_engine import LIBRARY
from holdfast.edge_runtime.engine import ONNXRUNTIME, C, ModelChoice
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.jobs import Workers
from holdfast.export.again import export_again
from holdfast.export.c.exporting import export_c
from holdfast.training.progress import stages
from studies.distortions.closed_loop import (
    CONTROLLER,
    closed_figures,
    closed_outcomes,
    loop_run,
)
from studies.distortions.open_loop import OpenJob, open_figures
from studies.distortions.table import TRIALS, UNCHANGED, by_name
from studies.shared_control.closed_loop import LoopRuns
from tools.harness import measured_now, write_figures

HANDS = ("six-fingertips", "two-pad-gripper", "three-fingertips", "twelve-sensors")
"""The first is the hand that the model was trained on; the others are compared with it."""
LOCKED_SEED = 7001
REVERSED = "[effects.magnet_reversed]\nsensors = [2, 5]\n"
"""Left out of the scene: sensors that a small hand has not."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    option = parser.add_argument
    model = model_path("holdfast-150hz")
    option("--model", type=path_argument, default=model, metavar="FILE")
    option("--trials", type=int, metavar="N", help="default: all of the scene")
    option("--hands", nargs="+", default=list(HANDS), metavar="CARD")
    engines = "what computes a step; c is generated and compiled, and much faster"
    option("--engine", choices=(ONNXRUNTIME, C), default=ONNXRUNTIME, help=engines)
    add_job_options(parser, 2)
    parser.set_defaults(seed=LOCKED_SEED)


def run(args: argparse.Namespace) -> int:
    """Measure every hand, write hands.json, print a line for each."""
    require_writable(args.out)
    path = Path(args.model)
    workers = chosen_workers(args)
    rows: list[Json] = []
    with stages(len(args.hands)) as say:
        for name in args.hands:
            say(name)
            hand = OnHand(name, args.out, args.trials, args.seed)
            rows.append(hand.figures(hand.exported(path, args.engine), workers))
    figures = {
        "kind": "simulated",
        **measured_now(),
        "model": Model(path).card.model_id,
        "engine": args.engine,
        "seed": args.seed,
        "trials": args.trials,
        "controller": CONTROLLER,
        "rows": rows,
    }
    written = write_figures(args.out / "hands.json", figures)
    for row in rows:
        print(line_of(row))
    print(written)
    return 0


def line_of(row: Json) -> str:
    """One hand's row in a sentence; "-": a share of nothing, where trials are few."""
    of_none = "-"
    found, in_time, called = (
        of_none if row[key] is None else f"{row[key]:.3f}"
        for key in ("found", "in_time", "called")
    )
    return (
        f"{row['hand']}: {found} found, {in_time} in time, {called} called, "
        f"{row['saved']} of {row['preventable']} saved, "
        f"{row['blocked']} of {row['handovers']} hand-overs blocked"
    )


class OnHand:
    """The trials on one hand. out: of its scene and of files for it. trials: None for all."""

    def __init__(self, name: str, out: Path, trials: int | None, seed: int) -> None:
        self.card = read_hand_card(name)
        self.file = out / f"{name}.onnx"
        self.trials = trials
        self.seed = seed
        self.scene = str(write_whole(out / f"{name}.toml", scene_text(name)))

    def exported(self, model: Path, engine: str) -> ModelChoice:
        """A model file's learner in a file for this hand."""
        export_again(model, self.file, self.card)
        if engine != C:
            return ModelChoice(str(self.file))
        folder = self.file.with_name(f"{self.file.stem}-c")
        export_c(self.file, folder, build=True)
        return ModelChoice(str(self.file), C, str(folder / LIBRARY))

    def figures(self, model: ModelChoice, workers: Workers) -> Json:
        """What became of the trials, open and in the closed loop."""
        job = OpenJob(model, UNCHANGED, self.scene, self.trials, self.seed)
        (outcomes,) = workers.run([job])
        runs = LoopRuns(model, workers, lambda share: None)
        wanted = loop_run(by_name()[UNCHANGED], self.scene, self.trials, self.seed)
        runs.run([wanted])
        closed = closed_outcomes(runs, wanted)
        about = {"hand": self.card.name, "sensors": self.card.n_sensors}
        found = open_figures(outcomes, outcomes) | closed_figures(closed, closed)
        found["delay_ms"] = outcomes.delay_ms
        # a change from itself says nothing
        kept = {key: found[key] for key in found if "change" not in key}
        return about | kept


def scene_text(hand: str) -> str:
    """The trials of the distortions on another hand."""
    text = TRIALS.read_text("utf-8")
    # A text that is not there would leave the scene as it is, and the row would lie.
    assert text.count(REVERSED) == 1
    text = text.replace(REVERSED, "")
    return text.replace("[[trials]]", f'[hand]\ncard = "{hand}"\n\n[[trials]]', 1)
