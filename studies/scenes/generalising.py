"""How far what was learned carries: a style left out, and how many trials it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.evaluation.window_scores import ClassScores, scores
from holdfast.export.network import IntArray
from holdfast.training.crossval import cross_validate
from holdfast.training.datasets import join
from holdfast.training.progress import Say
from holdfast.training.recording import DataSet
from studies.scenes.candidate import Candidate
from studies.scenes.figures import LearningPoint, StyleLeftOut

TRIALS = (100, 200, 400, 600, 800, 1000)
"""The thesis had 600, then 1000."""


def styles_left_out(
    sets: Mapping[str, DataSet], ways: Mapping[str, Candidate], seed: int, say: Say
) -> dict[str, StyleLeftOut]:
    """Style -> figures on its windows of forests trained on the other styles alone."""
    figures = {}
    for style, unseen in sets.items():
        say(f"{style} left out")
        seen = join([one for name, one in sets.items() if name != style])
        rows = {
            name: scores(unseen, _votes(way, seen, unseen, seed), seed=seed)
            for name, way in ways.items()
        }
        figures[style] = StyleLeftOut(len(seen.recordings), rows)
    return figures


def _votes(way: Candidate, seen: DataSet, unseen: DataSet, seed: int) -> IntArray:
    """[M, 8] votes on the unseen windows of a forest trained on all that are seen."""
    every = np.arange(len(seen.tasks["classes"]))
    return way.votes(seen, way.features(seen), every, way.features(unseen), seed)


def learning_curve(
    data: DataSet,
    features: Mapping[str, Any],
    ways: Mapping[str, Candidate],
    seed: int,
    counts: Sequence[int] = TRIALS,
) -> list[LearningPoint]:
    """Figures of every method from so many of the trials, trials held out."""
    order = np.random.default_rng(seed).permutation(len(data.recordings))
    task, points = data.tasks["classes"], []
    for count in (one for one in counts if one <= len(order)):
        mask = np.isin(task.trial, order[:count])
        part = replace(data, tasks={"classes": task.take(mask)})
        rows: dict[str, ClassScores] = {}
        for name, way in ways.items():
            held = cross_validate(
                part, {"classes": features[name][mask]}, way.plan, seed=seed
            )
            rows[name] = scores(part, held.votes["classes"], seed=seed)
        points.append(LearningPoint(count, int(mask.sum()), rows))
    return points
