"""`make real`: the whole job on public real recordings; writes metrics.json and report.html.

Train, cross-validate with people held out, export, verify, evaluate, report. The top-level figures
of metrics.json are those of the forest as it is: human_slip_uskin, 18 channels, clock-free, every
window answered by a forest trained without its person.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.progress import Say, Stages
from holdfast.core.writing import require_writable
from holdfast.data.metrics import HeadFigures, report
from holdfast.data.recording import DataSet
from holdfast.evaluation.formats import host, interval, number
from holdfast.evaluation.jobs import Workers
from holdfast.export.exporting import export_artifact
from holdfast.step.artifact import Artifact, write_artifact
from holdfast.step.heads import riskier_argmax
from holdfast.step.learner import reference_votes
from holdfast.step.network import IntArray
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    features_of,
    fit_learner,
    spec_for,
)
from holdfast.training.fitting import final_artifact, versions
from holdfast.training.plan import RAW_BASELINE, TrainingPlan
from studies.folds import leaky_folds
from studies.real.figures import FinalModel, RealStudy, StreamedFold, prediction_of
from studies.real.methods import METHODS, OURS, cross_validated, done
from studies.real.report import Evidence, write_real_report
from studies.real.streamed_fold import stream_one_fold
from studies.row_names import LEAKY, LEAKY_FOLDS, OURS_18
from tools.harness import write_figures

CLOCK_FREE = (
    "no feature sees anything older than 0.5 s; "
    "time, movement indices and IMUs are never inputs"
)
_FEW = replace(RAW_BASELINE.situation, n_estimators=30)
LEAKY_PLAN = replace(RAW_BASELINE, situation=_FEW, prediction=_FEW)
"""The raw forest with fewer trees, which flatters as much."""
ALONE = Workers()


def study_sets(out: Path, seed: int, say: Say, workers: Workers = ALONE) -> RealStudy:
    """Do everything and write the report; returns what metrics.json holds.

    workers: where the parts run; those of a cluster see the same `out` and data sets.
    """
    started = time.perf_counter()
    rows = cross_validated(METHODS, seed, workers, say)
    ours = rows[OURS_18].held_out
    heads = rows[OURS_18].figures
    data = OURS.data()
    parts = _parts(ours, heads, out.absolute(), seed)
    streamed, model, leaky_row = list(done(parts, workers, say))
    figures = RealStudy(
        heads=heads,
        data=data.name,
        kind=data.kind,
        channels=OURS.channels,
        clock_free=CLOCK_FREE,
        caveat=data.caveat,
        streamed_fold=streamed,
        rows={name: row.figures for name, row in rows.items()} | {LEAKY: leaky_row},
        model=model,
        seed=seed,
        host=host(),
        versions=versions(),
        seconds=round(time.perf_counter() - started, 1),
    )
    say("report")
    write_real_report(out / "report.html", Evidence(data, ours, figures))
    return figures


def _parts(
    ours: HeldOut, heads: HeadFigures, out: Path, seed: int
) -> dict[str, Callable[[], Any]]:
    """What follows the table: our files, and the leaky split."""
    return {
        "one fold's file, sealed, loaded and streamed sample by sample": partial(
            _streamed, ours, out, seed
        ),
        "final forests on all people, exported": partial(
            _final_model, ours, heads, out, seed
        ),
        LEAKY: partial(_leaky, seed),
    }


def _streamed(ours: HeldOut, out: Path, seed: int) -> StreamedFold:
    return stream_one_fold(OURS.data(), OURS.features(), OURS.plan, ours, out, seed)


def _final_model(ours: HeldOut, heads: HeadFigures, out: Path, seed: int) -> FinalModel:
    data = OURS.data()
    features = OURS.features()
    return final_model(
        final_artifact(data, features, ours, heads, OURS.plan, seed), out
    )


def _leaky(seed: int) -> HeadFigures:
    return leaky(OURS.data(), seed=seed)


def leaky(
    data: DataSet, plan: TrainingPlan = LEAKY_PLAN, *, seed: int = 0
) -> HeadFigures:
    """The raw forest with neighbouring windows on both sides of the split: wrong on purpose."""
    features = features_of(data, spec_for(data, plan.groups))
    votes = {
        task: _leaky_votes(data, features[task], plan, task, seed)
        for task in data.tasks
    }
    score = votes["predict_250ms"][:, 1].astype(np.float64)
    return report(data, riskier_argmax(votes["situations"]), score, seed=seed)


def _leaky_votes(
    data: DataSet, features: FloatRows, plan: TrainingPlan, task: str, seed: int
) -> IntArray:
    n_classes = len(data.tasks[task].classes)
    votes = np.zeros((len(features), n_classes), dtype=np.int64)
    for train, test in leaky_folds(len(features), LEAKY_FOLDS, seed=seed):
        forest = fit_learner(data, features, plan, task, train, seed)
        votes[test] = reference_votes(forest, features[test], n_classes)
    return votes


def final_model(artifact: Artifact, out: Path) -> FinalModel:
    """The file for the hand, from all people; it is not scored on its own training windows."""
    write_artifact(out / "human", artifact)
    path, exported = export_artifact(out / "human")
    return FinalModel(str(path.relative_to(out)), exported.bytes, exported)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_job_options(parser, 2)


def run(args: argparse.Namespace) -> int:
    """Run the whole job, write metrics.json, print the headline."""
    require_writable(args.out)
    workers = chosen_workers(args)
    say = Stages()
    figures = study_sets(args.out, args.seed, say, workers)
    path = write_figures(args.out / "metrics.json", figures.to_json())
    situations = figures.heads.situations
    head = prediction_of(figures.heads)
    print(
        f"macro F1 {number(situations.macro_f1, 3)} ({interval(situations.macro_f1_ci, 3)}), "
        f"AUC {number(head.auc, 3)} ({interval(head.auc_ci, 3)})"
    )
    print(figures.caveat)
    print(f"{path}, {args.out / 'report.html'} ({figures.seconds} s)")
    return 0
