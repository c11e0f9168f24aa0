"""The study: every idea is trained on some sets, its threshold chosen on others, and evaluated.

Trained on: `thesis`, `broad` and, for some ideas, `daily` and `perturbed-hold`. The threshold is
the lowest that leaves half a false alarm a minute on `daily`. Evaluated on: unseen trials of the
author's style (`author`), two unseen styles (`p1`, `p2`), and disturbed holds. All simulated. A
trial is on one side only, because the sets are simulated from different seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import cycle
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.evaluation.latency.timing import time_in_turns
from holdfast.training.featurise import FloatRows
from holdfast.training.progress import Say
from holdfast.training.windows import Choice
from studies.fast_handover.figures import HandoverStudy, IdeaFigures, WindowF1
from studies.fast_handover.ideas import IDEAS, Features, Idea
from studies.fast_handover.learners import Learner
from studies.fast_handover.sets import (
    CHOOSE,
    EVALUATED,
    STYLES,
    Labelled,
    Streams,
    joined,
    labelled,
    streams,
)
from studies.fast_handover.stream_scores import alarm_figures
from studies.fast_handover.timing import session_of
from studies.fast_handover.window_scores import bounds, macro_f1, objects_left_out

PAST_S = 0.020
"""A second F1 leaves out windows nearer to a change of phase, where no sensor is sharp enough."""
TURNS, CALLS = 20, 50


class Sets:
    """The sets of a folder, each read once with the features that an idea needs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.training = cache(self._training)
        self.evaluated = cache(self._evaluated)

    def _training(self, name: str, windows: Choice, features: Features) -> Labelled:
        return labelled(self.folder / name, windows, features)

    def _evaluated(self, name: str, features: Features) -> Streams:
        windows: Choice = "thesis" if name in STYLES else "natural"
        return streams(self.folder / name, windows, features)

    def part(self, idea: Idea) -> Labelled:
        """All that the idea is trained on."""
        return joined(
            [
                self.training(name, idea.windows, idea.features)
                for name in idea.trained_on
            ]
        )


def study(
    folder: Path, seed: int, say: Say, ideas: Sequence[Idea] = IDEAS
) -> HandoverStudy:
    """Rows of all ideas, and bounds.

    folder: holds the sets by their names, and keeps features. Raises what reading them raises.
    """
    sets, rows, timed = Sets(folder), [], {}
    for idea in ideas:
        say(idea.name)
        part, learner = sets.part(idea), idea.learner()
        learner.fit(part.features, part.label, seed)
        rows.append(_figures(idea, sets, part, learner, seed))
        timed[idea.name] = _calls(learner, part.features[:200])
    times_us = time_in_turns(timed, TURNS, CALLS)
    rows = [
        replace(row, learner_us=float(np.median(times_us[row.idea]))) for row in rows
    ]
    return HandoverStudy(rows, bounds(sets.evaluated("author", "default")))


def _figures(
    idea: Idea, sets: Sets, part: Labelled, learner: Learner, seed: int
) -> IdeaFigures:
    """One row: alarms on streams, then windows, then objects left out where the idea says so."""
    here = {name: sets.evaluated(name, idea.features) for name in (CHOOSE, *EVALUATED)}
    learned = {
        name: learner.answer(np.asarray(one.features)) for name, one in here.items()
    }
    alarms = alarm_figures(idea, here, learned, seed)
    windows = {name: _windows(here[name], learned[name][0]) for name in STYLES}
    worst = None
    if idea.objects_left_out:
        worst = min(objects_left_out(idea, part, here["author"], seed).values())
    return IdeaFigures(idea.name, alarms, windows, worst)


def _windows(streams: Streams, situation: npt.NDArray[np.int64]) -> WindowF1:
    return WindowF1(
        macro_f1(streams, situation), macro_f1(streams, situation, past_s=PAST_S)
    )


def _calls(learner: Learner, rows: FloatRows) -> Callable[[], object]:
    """Runs all models of a learner on one row."""
    sessions = [session_of(model, rows) for model in learner.models]
    one, turn = [rows[k : k + 1] for k in range(len(rows))], cycle(range(len(rows)))

    def call() -> None:
        row = one[next(turn)]
        for session in sessions:
            session.run(None, {session.get_inputs()[0].name: row})

    return call
