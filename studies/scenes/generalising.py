"""How far what was learned carries: a style left out, and how many trials it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from evaluation.scores import scores
from studies.scenes.candidate import Candidate
from training.crossval import cross_validate
from training.datasets.joined import join
from training.recording import DataSet
from training.say import Say

TRIALS = (100, 200, 400, 600, 800, 1000)
"""The thesis had 600, then 1000."""


def styles_left_out(
    sets: Mapping[str, DataSet], ways: Mapping[str, Candidate], seed: int, say: Say
) -> dict[str, Any]:
    """Style -> line -> figures on its windows of forests trained on the other styles alone."""
    figures: dict[str, Any] = {}
    for style, unseen in sets.items():
        say(f"{style} left out")
        met = join([one for name, one in sets.items() if name != style])
        figures[style] = {
            "trained_on_trials": len(met.recordings),
            "rows": {
                name: scores(
                    unseen,
                    way.votes(
                        met,
                        way.features(met),
                        np.arange(len(met.tasks["classes"])),
                        way.features(unseen),
                        seed,
                    ),
                    seed=seed,
                )
                for name, way in ways.items()
            },
        }
    return figures


def learning_curve(
    data: DataSet,
    features: Mapping[str, Any],
    ways: Mapping[str, Candidate],
    seed: int,
    counts: Sequence[int] = TRIALS,
) -> list[dict[str, Any]]:
    """Rows: so many of the trials, and each line's figures on them, trials held out."""
    order = np.random.default_rng(seed).permutation(len(data.recordings))
    task, rows = data.tasks["classes"], []
    for count in (one for one in counts if one <= len(order)):
        mask = np.isin(task.trial, order[:count])
        part = replace(data, tasks={"classes": task.take(mask)})
        row: dict[str, Any] = {"trials": count, "windows": int(mask.sum())}
        for name, way in ways.items():
            held = cross_validate(part, {"classes": features[name][mask]}, way.plan, seed=seed)
            found = scores(part, held.votes["classes"], seed=seed)
            row[name] = {
                level: {key: found[level][key] for key in ("macro_f1", "macro_f1_ci")}
                for level in ("four", "eight")
            }
        rows.append(row)
    return rows
