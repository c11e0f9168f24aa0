"""`make demo`, without hardware or data: simulate, train, export, and show unseen trials."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from examples.demo.demo_trials import RATE_HZ, TRAIN, TRIALS, UNSEEN
from holdfast.cli.command import path_argument
from holdfast.core.errors import HoldfastError
from holdfast.core.writing import require_writable
from tools.harness import run_script

RELEASED = "models/holdfast-150hz.onnx"
"""In the checkout."""
Await = Callable[[str], Path]
"""Name of a set -> its folder, once it is complete."""


def show_demo(out: Path, work: Path) -> int:
    """Train, export, show two unseen trials, and leave model and report in `out`."""
    trials = f"{TRIALS} trials in which a hand holds, passes on or loses an object"
    print(f"simulating {trials}, at {RATE_HZ:g} Hz", flush=True)
    with _simulated_beside(work) as ready:
        _learn_and_watch(out, work, ready)
    return 0


def _learn_and_watch(out: Path, work: Path, ready: Await) -> None:
    """All steps that need the libraries, which load while the trials are simulated."""
    from examples.demo.demo_grip import close_the_loop, section
    from examples.demo.demo_stream import stream
    from examples.demo.demo_watch import LEGEND, show, watch
    from holdfast.data.datasets import load
    from holdfast.edge_runtime.monitor import Model
    from holdfast.export.exporting import export_artifact
    from holdfast.training.fitting import train, versions
    from holdfast.training.plan import TrainingPlan
    from studies.real.pictures import confusion
    from studies.report import write_report

    data = load(ready(TRAIN), windows="thesis")
    trained = train(data, work / "model", TrainingPlan(), seed=0)
    macro_f1 = trained.figures.situations.macro_f1
    four = "how well it distinguishes four situations on new trials (macro F1, best 1)"
    print(f"{four}: {macro_f1:.2f}", flush=True)
    path, verified = export_artifact(work / "model", out / "holdfast.onnx")
    checked = verified.heads["situation"]
    differ = f"{checked.label_mismatches} of {checked.rows:,} answers differ"
    print(f"exported {path}: {differ} from the trained model's", flush=True)
    print(LEGEND)
    shipped = Model(Path(__file__).resolve().parents[2] / RELEASED)
    made, unseen, pictures = Model(path), ready(UNSEEN), []
    for one in load(unseen, windows="none").recordings:
        show(watch(shipped, unseen, one))
        pictures.append(watch(made, unseen, one))
    hands = close_the_loop(shipped)
    print("\nit closes the hand (two trials that were chosen to show it):")
    print("\n".join(f"  {one.sentence}" for one in hands))
    held_out = trained.held_out
    report = write_report(
        out / "report.html",
        "demo.html",
        kind=data.kind,
        data=data,
        situations=trained.figures.situations,
        trials=[(one.recording.trial_id, stream(one, data.kind)) for one in pictures],
        closed_loop=section(hands),
        confusion=confusion(data.with_situations(), held_out),
        versions=versions(),
    )
    print(f"\nreport: {report}")


@contextmanager
def _simulated_beside(work: Path) -> Iterator[Await]:
    """Simulate the trials in another process; yields a function that waits for a set.

    Raises HoldfastError.
    """
    command = [sys.executable, "-m", "examples.demo.demo_trials", str(work)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        names = iter(child.stdout or ())

        def ready(name: str) -> Path:
            if next(names, "").strip() != name:
                what = "the trials could not be simulated"
                raise HoldfastError(what, cause="see the lines above")
            return work / name

        try:
            yield ready
        finally:
            child.kill()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    parser.add_argument(
        "--out",
        type=path_argument,
        default=Path("build/demo"),
        metavar="DIR",
        help="folder for model and report (default build/demo)",
    )


def run(args: argparse.Namespace) -> int:
    """Show everything; the simulated trials go into a temporary folder."""
    require_writable(args.out)
    with tempfile.TemporaryDirectory() as work:
        return show_demo(args.out, Path(work))


if __name__ == "__main__":
    sys.exit(run_script("make demo", str(__doc__), add_arguments, run))
