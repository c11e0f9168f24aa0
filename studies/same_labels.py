"""`python -m studies same-labels --older FILE`: two files of one training on the same samples.

A step that is built anew keeps the learners. The sets are simulated for development, by seeds that
no locked set has; no figure of a file's quality is made of them.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

from holdfast.cli.command import path_argument
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.model_outputs import everywhere, steps_with
from holdfast.export.heads import situation_votes
from holdfast.training.datasets import load
from studies.default_model import MODEL
from tools.harness import SimulatedSet, measured_now, simulate_sets, write_figures

SETS = [
    SimulatedSet("wide", "wide", 500, 120),
    SimulatedSet("thesis", "thesis", 450, 121),
    SimulatedSet("daily", "daily", 200, 122),
]
COMPARED = ("unknown", "situation", "votes", "empty", "detectors", "usable_sensors")
"""Outputs that are counted where they differ; the situation and the votes of known samples."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument("--model", type=path_argument, default=MODEL, metavar="FILE")
    parser.add_argument("--older", type=path_argument, required=True, metavar="FILE")


def run(args: argparse.Namespace) -> int:
    """Simulate the sets, step both files over them; same-labels.json."""
    models = [Model(args.older), Model(args.model)]
    rate_hz = models[0].card.rate_hz
    sets = [SimulatedSet(**{**vars(one), "rate_hz": rate_hz}) for one in SETS]
    missing = [one for one in sets if not (args.out / one.folder).is_dir()]
    simulate_sets(missing, args.out)

    counts: Counter[str] = Counter()
    for one in sets:
        recordings = load(args.out / one.folder).recordings
        older, newer = (
            everywhere(steps_with(model, COMPARED), recordings) for model in models
        )
        counts += differences(older, newer)
    figures = {
        **measured_now(),
        "older": models[0].digest[:12],
        "newer": models[1].digest[:12],
        "sets": [vars(one) for one in sets],
        **counts,
    }
    print(write_figures(args.out / "same-labels.json", figures))
    return 0


def differences(older: Sequence[Outputs], newer: Sequence[Outputs]) -> Counter[str]:
    """Samples, known ones, and how many differ in each output; of labels also those off ties."""
    counts: Counter[str] = Counter()
    for one, other in zip(older, newer, strict=True):
        known = ~one["unknown"]
        counts["samples"] += len(known)
        counts["known"] += int(known.sum())
        for name in COMPARED:
            differs = one[name] != other[name]
            differs = differs.reshape(len(known), -1).any(axis=1)
            counts[f"{name} differs"] += int(differs.sum())
            counts[f"{name} differs where known"] += int((differs & known).sum())

        sums = np.sort(situation_votes(one["votes"]), axis=1)
        tied = sums[:, -1] == sums[:, -2]
        differs = (one["situation"] != other["situation"]) & known
        counts["labels that differ off ties"] += int((differs & ~tied).sum())
    return counts
