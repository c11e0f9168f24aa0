"""`python -m studies adapt`: what adapting to a person brings; writes adapt.json.

Each unseen style is answered by the shipped file as it is, and adapted to a person. A person is a
draw of the card `adapt` in that style; nothing of the test sets is seen while adapting.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import BoolArray, Json
from holdfast.core.writing import require_writable
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import votes_in_all
from holdfast.evaluation.alarms import (
    Answers,
    event_scores,
    match_alarms,
    ratio_interval,
    requests_at,
)
from holdfast.evaluation.trials import voluntary_actions
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
from holdfast.training.figures import Interval
from holdfast.training.metrics import draw_groups
from holdfast.training.recording import DataSet
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
DRAWS = 1000
OWN_ROW = re.compile(r'action = "pass"\ncount = \d+\n(.*?)\n\n', re.DOTALL)
"""How a card of another style hands over."""
BEFORE = "as it is"
ADAPTED = "adapted"
"""Files that answer."""


@dataclass(frozen=True)
class FileFigures:
    """Of all persons of a style, each on the same trials. called: share of voluntary actions."""

    called: float | None
    called_ci: Interval | None
    actions: int
    recall: float | None
    recall_ci: Interval | None
    events: int
    false_per_min: float | None
    false_per_min_ci: Interval | None
    before_gross_slip: float | None


Answered = tuple[Sequence[Answers], DecisionRules]
"""The answers of one person's file on a set, and its decision rules."""


def file_figures(persons: Sequence[Answered]) -> FileFigures:
    """Figures over persons. A trial answered by several persons' files is one group."""
    answers: list[Answers] = []
    requests: list[BoolArray] = []
    for of_one, rules in persons:
        answers += of_one
        requests += requests_at(of_one, rules, rules.min_risky_permille)
    pairs = zip(answers, requests, strict=True)
    scores = event_scores([match_alarms(one.recording, on) for one, on in pairs])
    called, interval, actions = _called(answers, requests)
    return FileFigures(
        called=called,
        called_ci=interval,
        actions=actions,
        recall=scores.recall,
        recall_ci=scores.recall_ci,
        events=scores.events,
        false_per_min=scores.false_per_min,
        false_per_min_ci=scores.false_per_min_ci,
        before_gross_slip=scores.in_time,
    )


def _called(
    answers: Sequence[Answers], requests: Sequence[BoolArray]
) -> tuple[float | None, Interval | None, int]:
    """Share of voluntary actions with a request, its interval over groups, and how many."""
    groups = np.unique([one.recording.group for one in answers], return_inverse=True)[1]
    sums = np.zeros((groups.max(initial=-1) + 1, 2))
    for group, one, on in zip(groups, answers, requests, strict=True):
        for action in voluntary_actions(one.recording):
            sums[group] += [on[action.first : action.stop].any(), 1]
    called, actions = sums.sum(axis=0).tolist()
    drawn = draw_groups(len(sums), DRAWS, 0) @ sums if len(sums) > 1 else None
    share = called / actions if actions else None
    return share, ratio_interval(drawn, 0, 1), int(actions)


def study_style(
    model: Model, style: str, others: Sequence[Stream], folder: Path
) -> Json:
    """Figures of both files on a style's test set, and the points that adapting chose."""
    test = streams_of(model, test_set(style, folder))
    as_it_is: Answered = ([one.answers for one in test], model.card.decision)
    weights = label_weights(model)
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    adapted: list[Answered] = []
    points = []
    for number in range(PERSONS):
        sys.stderr.write(f"{style}, person {number + 1} of {PERSONS}\n")
        own = streams_of(model, person_set(style, number, folder))
        evidence = Evidence(own, others, model.card.decision, weights, in_all)
        point = evidence.choose(threshold_only=False)
        correction = evidence.correction(point)
        answers = [corrected(one, correction, weights) for one in test]
        adapted.append((answers, point.rules))
        points.append(asdict(point))
    files: dict[str, list[Answered]] = {BEFORE: [as_it_is], ADAPTED: adapted}
    figures = {name: asdict(file_figures(of)) for name, of in files.items()}
    return {"ways": figures, "points": points}


def study_styles(model: Model, styles: Sequence[str]) -> Json:
    """Figures of every style, and what they were simulated from."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        slips = _simulated("thesis", folder / "slips", SLIPS_SEED, SLIPS_TRIALS)
        others = streams_of(model, slips)
        found = {style: study_style(model, style, others, folder) for style in styles}
    seeds = {"test": TEST_SEED, "persons": PERSON_SEED, "slips": SLIPS_SEED}
    return {"kind": "simulated", "styles": found, "seeds": seeds, "persons": PERSONS}


def person_set(style: str, number: int, folder: Path) -> DataSet:
    """The two minutes of one simulated person: the card `adapt`, acted in a style."""
    card = folder / f"adapt-{style}.toml"
    card.write_text(adapt_card(style), encoding="utf-8")
    out = folder / f"{style}-{number}"
    return _simulated(str(card), out, PERSON_SEED + number, None)


def test_set(style: str, folder: Path) -> DataSet:
    """Pulls, falls, passes and put-downs of a style."""
    own = OTHER_CARDS / f"{style}.toml"
    card = str(own) if own.exists() else style
    return _simulated(card, folder / style, TEST_SEED, TEST_TRIALS)


def adapt_card(style: str) -> str:
    """The shipped card with the style's way of handing over."""
    text = (SCENES / "adapt.toml").read_text("utf-8")
    own = OTHER_CARDS / f"{style}.toml"
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


def _simulated(card: str, out: Path, seed: int, trials: int | None) -> DataSet:
    write_set(Scene(read_scene_file(card), seed), out, trials, lambda n: None)
    return load(out, windows="none")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    only = "these styles alone"
    parser.add_argument("--only", nargs="+", choices=STYLES, default=STYLES, help=only)


def run(args: argparse.Namespace) -> int:
    """Study the styles; write the figures."""
    require_writable(args.out)
    figures = study_styles(Model(MODEL), args.only)
    sys.stdout.write(f"{write_figures(args.out / 'adapt.json', figures)}\n")
    return 0
