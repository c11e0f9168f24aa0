"""`python -m studies adapt`: writes adapt.json, or with --people people.json.

Each unseen style is answered by the shipped file as it is, with its threshold chosen for a person,
and with the whole adaptation. A person is a draw of the card `adapt` in that style; nothing of the
test sets is seen while adapting. With --people, the same on a public set of people.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from holdfast.core.contract import Json
from holdfast.core.writing import require_writable
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import votes_in_all
from holdfast.sessions.adapt import Evidence
from holdfast.sessions.adapt_evidence import (
    Stream,
    corrected,
    label_weights,
    streams_of,
)
from holdfast.simulation import SCENES
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.recording import DataSet
from studies.adapt.figures import BEFORE, THRESHOLD, WHOLE, Way, way_figures
from studies.shared_control.plan import CARDS as OTHER_CARDS
from tools.harness import write_figures

MODEL = Path("models/holdfast-150hz.onnx")
STYLES = ("p1", "p2", "quick", "slow")
"""The operating rule of `holdfast adapt` was chosen on p1 and p2; quick and slow came after it."""
PERSONS = 3
TEST_SEED = 1003
PERSON_SEED = 5000
TEST_TRIALS = 200
SLIPS_SEED = 1
"""Models are trained on seed 0."""
SLIPS_TRIALS = 300
OWN_ROW = re.compile(r'action = "pass"\ncount = \d+\n(.*?)\n\n', re.DOTALL)


def study_style(
    model: Model, style: str, others: Sequence[Stream], folder: Path
) -> Json:
    """Figures of every way on a style's test set."""
    test = streams_of(model, test_set(style, folder))
    ways: dict[str, list[Way]] = {
        BEFORE: [([one.answers for one in test], model.card.decision)]
    }
    points: dict[str, list[Json]] = {THRESHOLD: [], WHOLE: []}
    for number in range(PERSONS):
        sys.stderr.write(f"{style}, person {number + 1} of {PERSONS}\n")
        own = streams_of(model, person_set(style, number, folder))
        for name in points:
            way, point = _adapted(model, own, others, test, whole=name == WHOLE)
            ways.setdefault(name, []).append(way)
            points[name].append(point)
    return {
        "ways": {name: asdict(way_figures(one)) for name, one in ways.items()},
        "points": points,
    }


def _adapted(
    model: Model,
    own: Sequence[Stream],
    others: Sequence[Stream],
    test: Sequence[Stream],
    *,
    whole: bool,
) -> tuple[Way, Json]:
    weights = label_weights(model)
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    evidence = Evidence(own, others, model.card.decision, weights, in_all)
    point = evidence.choose(threshold_only=not whole)
    correction = evidence.correction(point)
    return ([corrected(one, correction, weights) for one in test], point.rules), asdict(
        point
    )


def study_styles(model: Model) -> Json:
    """Figures of every style, and what they were simulated from."""
    with tempfile.TemporaryDirectory() as folder:
        slips = _simulated("thesis", Path(folder) / "slips", SLIPS_SEED, SLIPS_TRIALS)
        others = streams_of(model, slips)
        styles = {
            style: study_style(model, style, others, Path(folder)) for style in STYLES
        }
    return {
        "kind": "simulated",
        "styles": styles,
        "seeds": {"test": TEST_SEED, "persons": PERSON_SEED, "slips": SLIPS_SEED},
        "persons": PERSONS,
        "slip_trials": SLIPS_TRIALS,
    }


def person_set(style: str, number: int, folder: Path) -> DataSet:
    """The two minutes of one simulated person: the card `adapt`, acted in a style."""
    card = folder / f"adapt-{style}.toml"
    card.write_text(_adapt_card(style), encoding="utf-8")
    return _simulated(
        str(card), folder / f"{style}-{number}", PERSON_SEED + number, None
    )


def test_set(style: str, folder: Path) -> DataSet:
    """Pulls, falls, passes and put-downs of a style."""
    own = OTHER_CARDS / f"{style}.toml"
    return _simulated(
        str(own) if own.exists() else style, folder / style, TEST_SEED, TEST_TRIALS
    )


def _adapt_card(style: str) -> str:
    """The shipped card with the style's way of handing over."""
    text = (SCENES / "adapt.toml").read_text("utf-8")
    own = OTHER_CARDS / f"{style}.toml"
    if not own.exists():
        return re.sub(r'(action = "\w[\w-]*"\n)', rf'\1style = "{style}"\n', text)
    row = OWN_ROW.search(own.read_text("utf-8"))
    assert row is not None
    kept = [
        one
        for one in row[1].split("\n")
        if not one.startswith(("close_at_s", "tail_s"))
    ]
    return text.replace(
        'action = "pass"\n', 'action = "pass"\n' + "\n".join(kept) + "\n"
    )


def _simulated(card: str, out: Path, seed: int, trials: int | None) -> DataSet:
    write_set(Scene(read_scene_file(card), seed), out, trials, lambda n: None)
    return load(out, windows="none")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument(
        "--people", action="store_true", help="people of human_slip_uskin instead"
    )


def run(args: argparse.Namespace) -> int:
    """Study the styles or the people; write the figures."""
    require_writable(args.out)
    started = time.process_time()
    if args.people:
        # reads the public set and loads scikit-learn
        from studies.adapt.people import study_people

        name = "people.json"
        figures = study_people()
    else:
        name = "adapt.json"
        figures = study_styles(Model(MODEL))
    cpu_s = round(time.process_time() - started, 1)
    path = write_figures(args.out / name, figures | {"cpu_s": cpu_s})
    sys.stdout.write(f"{path} ({cpu_s} CPU s)\n")
    return 0
