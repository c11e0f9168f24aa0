"""Further rows on human_slip_uskin: `make study NAME=real-more`; all-channels.json, truer.json.

Two questions beside the headline of `make real`. What would all 48 channels bring? And what is left
of the figures under a truer label? The set's usual label is the object's rotation, about half of it
the wrist's; with the hand's IMU the wrist cancels. The same people, folds, features and baselines.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.reading import Json
from holdfast.core.writing import require_writable
from holdfast.evaluation.jobs import Workers
from holdfast.training.plan import RAW_BASELINE, TrainingPlan
from holdfast.training.progress import Say, stages
from studies.real.methods import BASELINES, OURS, Method, cross_validated
from studies.row_names import OURS_18, OURS_48, RAW_48, RAW_48_FOLDS
from tools.harness import write_figures

Methods = dict[str, Method]
FURTHER: dict[str, Methods] = {
    "truer": {
        name: replace(one, in_hand=True, verified=False)
        for name, one in ({OURS_18: OURS} | BASELINES).items()
    },
    "all-channels": {
        OURS_48: Method(TrainingPlan(), channels=48),
        RAW_48: Method(replace(RAW_BASELINE, folds=RAW_48_FOLDS), channels=48),
    },
}
"""File -> its rows."""


def further_rows(methods: Methods, seed: int, workers: Workers, say: Say) -> Json:
    """Figures by stored name of the method, people held out; how many windows of each situation."""
    found = cross_validated(methods, seed, workers, say)
    data = next(iter(methods.values())).data()
    task = data.tasks["situations"]
    counts = np.bincount(task.label, minlength=len(task.classes)).tolist()
    return {
        "kind": data.kind,
        "windows": dict(zip(task.classes, counts, strict=True)),
        "rows": {name: row.figures.to_json() for name, row in found.items()},
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_job_options(parser, 2)


def run(args: argparse.Namespace) -> int:
    """Write a file for each question as soon as it is answered."""
    require_writable(args.out)
    folds = [one.plan.folds for methods in FURTHER.values() for one in methods.values()]
    with stages(sum(folds) + len(FURTHER)) as say:
        for name, methods in FURTHER.items():
            rows = further_rows(methods, args.seed, chosen_workers(args), say)
            write_figures(args.out / f"{name}.json", rows)
    return 0
