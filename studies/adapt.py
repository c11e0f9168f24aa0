"""`python -m studies adapt`: what adapting to a person brings in a closed loop; writes adapt.json.

Each unseen style is answered by the shipped file as it is, and by files that `holdfast adapt` makes
for persons of that style. A person is a draw of the card `adapt`, acted in the style; nothing of
the test sets is seen while adapting.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from pathlib import Path

from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.progress import Stages
from holdfast.core.writing import require_writable
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.jobs import Workers
from holdfast.sessions.adapt import adapt_file
from holdfast.simulation import SCENES
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from studies.shared_control.closed_loop import LoopRuns, LoopSet
from studies.shared_control.plan import CARDS, OUR_REQUEST, SEED, UNSEEN, sets
from tools.harness import measured_now, write_figures

MODEL = Path("models/holdfast-150hz.onnx")
STYLES = UNSEEN
"""The operating rule of `holdfast adapt` was chosen on p1 and p2; quick and slow came after it."""
PERSONS = 2
PERSON_SEED = 5000
PSEUDONYM = "p01"
TRIALS = 55
SLIPS_SEED = 1
"""Models are trained on seed 0."""
SLIPS_TRIALS = 300
OWN_ROW = re.compile(r'action = "pass"\ncount = \d+\n(.*?)\n\n', re.DOTALL)
"""How a card of another style hands over."""


def study_style(
    style: str, one: LoopSet, slips: Path, folder: Path, workers: Workers
) -> list[Json]:
    """A row for the shipped file and for each person's file, on the same trials of a style."""
    files = {"as it is": MODEL}
    for number in range(PERSONS):
        name = f"adapted to person {number + 1}"
        own = person_set(style, number, folder)
        files[name] = folder / f"{style}-{number}.onnx"
        # A file that is no better than its base is measured, too.
        adapt_file(
            *(MODEL, str(own), PSEUDONYM, str(slips), files[name], Stages()),
            worse_too=True,
        )

    rows = []
    for name, path in files.items():
        progress = Stages()
        progress(f"{style}, {name}")
        runs = LoopRuns(ModelChoice(str(path)), workers, progress.part)
        runs.run([(one, OUR_REQUEST)])
        figures = runs.figures(one, OUR_REQUEST).to_json()
        rows.append({"style": style, "file": name, **figures})
    return rows


def person_set(style: str, number: int, folder: Path) -> Path:
    """The two minutes of one simulated person: the card `adapt`, acted in a style."""
    card = folder / f"adapt-{style}.toml"
    card.write_text(adapt_card(style), encoding="utf-8")
    return _simulated(str(card), folder / f"{style}-{number}", PERSON_SEED + number)


def adapt_card(style: str) -> str:
    """The shipped card with the style's way of handing over."""
    text = (SCENES / "adapt.toml").read_text("utf-8")
    own = CARDS / f"{style}.toml"
    if not own.exists():
        return re.sub(r'(action = "\w[\w-]*"\n)', rf'\1style = "{style}"\n', text)
    row = OWN_ROW.search(own.read_text("utf-8"))
    assert row is not None
    kept = []
    for line in row[1].split("\n"):
        if not line.startswith(("close_at_s", "tail_s")):
            kept.append(line)
    passes = 'action = "pass"\n'
    return text.replace(passes, passes + "\n".join(kept) + "\n")


def _simulated(card: str, out: Path, seed: int, trials: int | None = None) -> Path:
    write_set(Scene(read_scene_file(card), seed), out, trials, lambda n: None)
    return out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    only = "these styles alone"
    parser.add_argument("--only", nargs="+", choices=STYLES, default=STYLES, help=only)
    parser.add_argument("--trials", type=int, default=TRIALS, help="of each style")
    add_job_options(parser, 2)


def run(args: argparse.Namespace) -> int:
    """Study the styles; write the figures."""
    require_writable(args.out)
    seed = SEED if args.seed is None else args.seed
    by_name = sets(args.trials, seed)
    rows: list[Json] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        slips = _simulated("thesis", folder / "slips", SLIPS_SEED, SLIPS_TRIALS)
        for style in args.only:
            workers = chosen_workers(args)
            rows += study_style(style, by_name[style], slips, folder, workers)
    about = {"kind": "simulated", "seed": seed, **measured_now()}
    figures = {**about, "trials": args.trials, "persons": PERSONS, "rows": rows}
    sys.stdout.write(f"{write_figures(args.out / 'adapt.json', figures)}\n")
    return 0
