"""`make demo`: no hardware, no data set: simulate, train, export, and watch trials go by that the
model never met."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from edge_runtime.command import Parser, finish, path_argument
from edge_runtime.errors import HoldfastError
from edge_runtime.writing import require_writable
from holdfast.demo_trials import RATE_HZ, TRAIN, TRIALS, UNSEEN

Await = Callable[[str], Path]
"""Name of a set -> its folder, once it is whole."""


def run(out: Path, work: Path) -> int:
    """Train, export, show three trials the model has never seen, and leave model and report in
    out."""
    print(
        f"simulating {TRIALS} trials of the thesis' protocol at {RATE_HZ:g} Hz (simulated: no recording)",
        flush=True,
    )
    with _simulated_beside(work) as ready:
        _learn_and_watch(out, work, ready)
    print("real recordings: make real (needs HOLDFAST_DATA; holdfast doctor says what is there)")
    return 0


def _learn_and_watch(out: Path, work: Path, ready: Await) -> None:
    """All that needs the libraries: they are loaded here, while the trials are simulated."""
    from edge_runtime.monitor import Model
    from export.exporting import export_artifact
    from holdfast.demo_watch import COLUMN_S, show, watch
    from studies.scenes.report import demo_report
    from training.datasets.thesis import load
    from training.fitting import train, versions
    from training.plan import TrainingPlan

    data = load(ready(TRAIN))
    trained = train(data, work / "model", TrainingPlan(), seed=0)
    macro_f1 = trained.figures["situations"]["macro_f1"]
    print(f"macro F1 over four situations, trials held out: {macro_f1:.2f}", flush=True)
    path, verified = export_artifact(work / "model", out / "holdfast.onnx")
    checked = verified["heads"]["situation"]
    print(
        f"exported {path}: {checked['rows']:,} rows checked, {checked['label_mismatches']} labels differ",
        flush=True,
    )
    print(
        f"\none character = {COLUMN_S} s; . nothing, g grasp, s safe slip, R risky slip, ? unknown (settling)"
    )
    unseen, model = ready(UNSEEN), Model(path)
    pictures = [watch(model, unseen, one) for one in load(unseen, windows="natural").recordings]
    for picture in pictures:
        show(picture)
    about = {"seed": 0, "versions": versions(), "command": "make demo"}
    print(f"\nreport: {demo_report(out / 'report.html', data, trained.held_out, about, pictures)}")


@contextmanager
def _simulated_beside(work: Path) -> Iterator[Await]:
    """The demo's trials in another process; yields what waits for one of its sets. Raises
    HoldfastError."""
    command = [sys.executable, "-m", "holdfast.demo_trials", str(work)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        said = iter(child.stdout or ())

        def ready(name: str) -> Path:
            if next(said, "").strip() != name:
                raise HoldfastError(
                    "the trials could not be simulated", cause="see the lines above"
                )
            return work / name

        try:
            yield ready
        finally:
            child.kill()


def main(argv: Sequence[str]) -> int:
    """Parse and run; what is simulated goes into a temporary folder, which is removed."""
    parser = Parser(
        prog="make demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out",
        type=path_argument,
        default=Path("build/demo"),
        metavar="DIR",
        help="default build/demo",
    )
    args = parser.parse_args(argv)
    require_writable(args.out)
    with tempfile.TemporaryDirectory() as work:
        return run(args.out, Path(work))


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
