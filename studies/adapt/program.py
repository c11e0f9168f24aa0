"""`python -m studies adapt`: writes adapt.json, or with --people people.json.

Each unseen style is answered by the shipped file as it is, with its threshold chosen for a person,
and with the whole adaptation. A person is a draw of the card `adapt` in that style; nothing of the
test sets is seen while adapting. With --people, the same on a public set of people.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from holdfast.core.reading import Json
from holdfast.core.writing import require_writable
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import votes_in_all
from holdfast.sessions.adapting import (
    SEED,
    TRIALS,
    choose,
    correction_at,
    simulated_slips,
)
from holdfast.sessions.slip_evidence import (
    Stream,
    corrected,
    label_weights,
    streams_of,
)
from studies.adapt.figures import BEFORE, THRESHOLD, WHOLE, Way, way_figures
from studies.adapt.sets import (
    PERSON_SEED,
    PERSONS,
    STYLES,
    TEST_SEED,
    person_set,
    test_set,
)
from tools.harness import write_figures

MODEL = Path("models/holdfast-150hz.onnx")


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
    weights, base = label_weights(model), model.card.decision
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    point = choose(own, others, base, weights, in_all if whole else None)
    correction = correction_at(point, own, others, in_all)
    return ([corrected(one, correction, weights) for one in test], point.rules), asdict(
        point
    )


def study_styles(model: Model) -> Json:
    """Figures of every style, and what they were simulated from."""
    others = streams_of(model, simulated_slips(model.card))
    with tempfile.TemporaryDirectory() as folder:
        styles = {
            style: study_style(model, style, others, Path(folder)) for style in STYLES
        }
    return {
        "kind": "simulated",
        "styles": styles,
        "seeds": {"test": TEST_SEED, "persons": PERSON_SEED, "slips": SEED},
        "persons": PERSONS,
        "slip_trials": TRIALS,
    }


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

        name, figures = "people.json", study_people()
    else:
        name, figures = "adapt.json", study_styles(Model(MODEL))
    cpu_s = round(time.process_time() - started, 1)
    path = write_figures(args.out / name, figures | {"cpu_s": cpu_s})
    sys.stdout.write(f"{path} ({cpu_s} CPU s)\n")
    return 0
