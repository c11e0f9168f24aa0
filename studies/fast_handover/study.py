"""`python -m studies fast-handover`: each idea is trained, its threshold chosen, and evaluated.

Trained on: `thesis`, `broad` and, for some ideas, `daily` and `perturbed-hold`. The threshold is
the lowest that leaves half a false alarm a minute on `daily`. Evaluated on: unseen trials of the
author's style (`author`), two unseen styles (`p1`, `p2`), and disturbed holds. All simulated. A
trial is on one side only, because the sets are simulated from different seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np

from holdfast.core.reading import Json
from holdfast.core.writing import require_writable
from holdfast.evaluation.latency.timing import time_in_turns
from holdfast.training.featurise import FloatRows
from holdfast.training.progress import Say, stages
from holdfast.training.windows import Choice
from studies.fast_handover.ideas import IDEAS, Features, Idea
from studies.fast_handover.learners import Learner
from studies.fast_handover.sets import (
    CHOOSE,
    EVALUATED,
    STYLES,
    Labelled,
    Streams,
    streams,
    training_part,
)
from studies.fast_handover.stream_scores import alarm_figures
from studies.fast_handover.timing import session_of
from studies.fast_handover.window_scores import bounds, macro_f1, objects_left_out
from studies.stream_sets import STREAMS, add_sets_option, sets_folder
from tools.harness import SimulatedSet, write_figures

SETS = [
    *STREAMS,
    SimulatedSet("daily", "daily", 200, 3),
    SimulatedSet("holds", "perturbed-hold", 150, 4),
]
PAST_S = 0.020
"""A second F1 leaves out windows nearer to a change of phase, where no sensor is sharp enough."""
TURNS = 20
CALLS = 50


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_sets_option(parser)


def run(args: argparse.Namespace) -> int:
    """Study, write figures.json, print the main columns."""
    require_writable(args.out)
    folder = sets_folder(args.sets, SETS, args.out)
    with stages(len(IDEAS)) as say:
        figures = study(folder, args.seed, say)
    path = write_figures(args.out / "figures.json", figures)
    for row in figures["rows"]:
        scores = [f"{row[f'f1_{style}']:.3f}" for style in STYLES]
        sys.stdout.write(f"{' '.join(scores)}  {row['idea']}\n")
    sys.stdout.write(f"{path}\n")
    return 0


def study(folder: Path, seed: int, say: Say, ideas: Sequence[Idea] = IDEAS) -> Json:
    """figures.json: rows of all ideas, and what an observer that is late would reach.

    folder: holds the sets by their names, and keeps features. Raises what reading them raises.
    """
    rows: list[Json] = []
    timed = {}
    for idea in ideas:
        say(idea.name)
        learner = idea.learner()
        part = training_part(folder, idea.trained_on, idea.windows, idea.features)
        learner.fit(part.features, part.label, seed)
        rows.append(_row(idea, folder, part, learner, seed))
        timed[idea.name] = _calls(learner, part.features[:200])
    times_us = time_in_turns(timed, TURNS, CALLS)
    for row in rows:
        row["learner_us"] = float(np.median(times_us[row["idea"]]))
    late = bounds(_evaluated(folder, "author", "default"))
    return {"kind": "simulated", "rows": rows, "bounds": late}


def _evaluated(folder: Path, name: str, features: Features) -> Streams:
    windows: Choice = "thesis" if name in STYLES else "natural"
    return streams(folder / name, windows, features)


def _row(idea: Idea, folder: Path, part: Labelled, learner: Learner, seed: int) -> Json:
    """Alarms on streams, then windows, then objects left out where the idea says so."""
    here = {
        name: _evaluated(folder, name, idea.features) for name in (CHOOSE, *EVALUATED)
    }
    learned = {
        name: learner.answer(np.asarray(one.features)) for name, one in here.items()
    }
    row: Json = {"idea": idea.name} | alarm_figures(idea, here, learned, seed)
    for name in STYLES:
        situation = learned[name][0]
        row[f"f1_{name}"] = macro_f1(here[name], situation)
        row[f"f1_{name}_past"] = macro_f1(here[name], situation, past_s=PAST_S)
    if idea.objects_left_out:
        by_object = objects_left_out(idea, part, here["author"], seed)
        row["worst_object"] = min(by_object.values())
    return row


def _calls(learner: Learner, rows: FloatRows) -> Callable[[], object]:
    """Runs all models of a learner on one row."""
    sessions = [session_of(model, rows) for model in learner.models]
    one = [rows[k : k + 1] for k in range(len(rows))]
    turn = cycle(range(len(rows)))

    def call() -> None:
        row = one[next(turn)]
        for session in sessions:
            session.run(None, {session.get_inputs()[0].name: row})

    return call
