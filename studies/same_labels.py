"""`python -m studies same-labels --older FILE`: two files of one training on the same samples.

A step that is built anew keeps the learners. The sets are simulated for development, by seeds that
no locked set has; no figure of a file's quality is made of them.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from holdfast.cli.command import path_argument
from holdfast.data.datasets import load
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.model_outputs import everywhere, steps_with
from holdfast.step.heads import situation_votes
from studies.default_model import MODEL
from tools.harness import SimulatedSet, measured_now, simulate_sets, write_figures

SETS = [
    SimulatedSet("wide", "wide", 500, 120),
    SimulatedSet("thesis", "thesis", 450, 121),
    SimulatedSet("daily", "daily", 200, 122),
]
COMPARED = ("unknown", "situation", "votes", "empty", "detectors")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument("--model", type=path_argument, default=MODEL, metavar="FILE")
    parser.add_argument("--older", type=path_argument, required=True, metavar="FILE")


def run(args: argparse.Namespace) -> int:
    """Simulate the sets, step both files over all; same-labels.json."""
    models = [Model(args.older), Model(args.model)]
    sets = [replace(one, rate_hz=models[0].card.rate_hz) for one in SETS]
    simulate_sets(sets, args.out)

    counts: Counter[str] = Counter()
    for one in sets:
        recordings = load(args.out / one.folder, windows="none").recordings
        older, newer = (everywhere(steps_with(m, COMPARED), recordings) for m in models)
        counts.update(differences(older, newer))
    of_sets = {"sets": [asdict(one) for one in sets], **counts}
    files = {"older": models[0].card.model_id, "newer": models[1].card.model_id}
    found = {**measured_now(), **files, **of_sets}
    print(write_figures(args.out / "same-labels.json", found))
    return 0


def differences(older: Sequence[Outputs], newer: Sequence[Outputs]) -> Counter[str]:
    """Samples, and how many differ in each output; of known labels also those that are no tie."""
    counts: Counter[str] = Counter()
    for one, other in zip(older, newer, strict=True):
        known = ~one["unknown"]
        counts["samples"] += len(known)
        for name in COMPARED:
            apart = (one[name] != other[name]).reshape(len(known), -1)
            counts[f"{name} differs"] += int(apart.any(axis=1).sum())

        first, second = np.sort(situation_votes(one["votes"]), axis=1)[:, :-3:-1].T
        apart = (one["situation"] != other["situation"]) & known
        counts["label differs and is no tie"] += int((apart & (first > second)).sum())
    return counts
