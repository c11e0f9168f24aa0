"""`make real`: the whole job on public real recordings; writes metrics.json and report.html.

Train, cross-validate with people held out, export, verify, evaluate, report. The top-level figures
of metrics.json are the headline: human_slip_uskin, 18 channels, clock-free, every window answered
by a forest trained without its person.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.edge_runtime.command import Parser, finish, path_argument, seed
from holdfast.edge_runtime.writing import require_writable, write_whole
from holdfast.evaluation.cells import interval, number
from holdfast.evaluation.job_options import add_job_options, chosen_workers
from holdfast.evaluation.jobs import Workers
from holdfast.evaluation.provenance import host
from holdfast.export.artifact import Artifact, write_artifact
from holdfast.export.exporting import export_artifact
from holdfast.studies.real import baselines
from holdfast.studies.real.eflesh import EfleshStudy, study_eflesh
from holdfast.studies.real.figures import (
    FinalModel,
    RealStudy,
    StreamedFold,
    VerificationSums,
    prediction_of,
)
from holdfast.studies.real.proactive import ReplayPicture, study_proactive
from holdfast.studies.real.report import Evidence, write_report
from holdfast.studies.real.streamed_fold import stream_one_fold
from holdfast.studies.row_names import CLOCK, LEAKY, OURS_18, OURS_48
from holdfast.training.crossval import HeldOut, cross_validate
from holdfast.training.datasets import load
from holdfast.training.featurise import FeatureCost, cpu_cost, features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import final_artifact, held_out_figures, versions
from holdfast.training.plan import TrainingPlan
from holdfast.training.progress import stages
from holdfast.training.say import Say, ignored

HUMAN = "human_slip_uskin"
CLOCK_FREE = (
    "no feature sees anything older than 0.5 s; time, movement indices and IMUs are never inputs"
)
ALONE = Workers()
STAGES = 24
"""Lines the progress bar expects; a wrong number only makes the bar end early or late."""


@dataclass(frozen=True)
class Ours:
    """Our forests on 18 channels: what each person's windows were answered, and the files."""

    held_out: HeldOut
    heads: HeadFigures
    cost: FeatureCost
    streamed: StreamedFold
    model: FinalModel


def run(out: Path, seed: int, say: Say, workers: Workers = ALONE) -> RealStudy:
    """Do everything and write the report; returns what metrics.json holds.

    workers: where the parts run; those of a cluster see the same `out` and data sets.
    """
    started = time.perf_counter()
    ours, *rows, eflesh, pictures = _all_parts(out.absolute(), seed, say, workers)
    data = load(HUMAN)
    figures = RealStudy(
        heads=ours.heads,
        data=data.name,
        kind=data.kind,
        channels=18,
        clock_free=CLOCK_FREE,
        caveat=data.caveat,
        verification=verification_of(ours.held_out),
        features_cost=ours.cost,
        streamed_fold=ours.streamed,
        rows={OURS_18: ours.heads} | dict(zip(ROWS, rows, strict=True)),
        eflesh_slip=eflesh.figures,
        model=ours.model,
        seed=seed,
        host=host(),
        versions=versions(),
        seconds=round(time.perf_counter() - started, 1),
    )
    say("report")
    write_report(out / "report.html", Evidence(data, ours.held_out, figures, eflesh, pictures))
    return figures


def _all_parts(out: Path, seed: int, say: Say, workers: Workers) -> list[Any]:
    """Results of all parts: ours, the other rows of the table, and the two smaller sets."""
    parts: dict[str, Callable[[Say], object]] = {
        OURS_18: partial(ours_18, out, seed),
        **{name: partial(_row, name, seed) for name in ROWS},
        "eflesh_slip: blocks held out": partial(_eflesh, seed),
        "proactive_slip_uskin: two slips replayed": partial(_proactive, seed),
    }
    if workers.here:
        return [_announced(title, part, say) for title, part in parts.items()]
    results = []
    jobs = [partial(part, ignored) for part in parts.values()]
    for title, result in zip(parts, workers.run(jobs), strict=True):
        say(f"{title}: done")
        results.append(result)
    return results


def _announced(title: str, part: Callable[[Say], object], say: Say) -> object:
    say(title)
    return part(say)


def ours_18(out: Path, seed: int, say: Say) -> Ours:
    """Our forests, people held out; one fold's file streamed; the final file from all people."""
    plan, data = TrainingPlan(), load(HUMAN)
    spec = spec_for(data, plan.groups)
    features = features_of(data, spec)
    held_out = cross_validate(data, features, plan, seed=seed, say=say, verify_spec=spec)
    heads = held_out_figures(data, held_out, seed)
    cost = cpu_cost(data, spec)
    say("one fold's file, sealed, loaded and streamed sample by sample")
    streamed = stream_one_fold(data, features, plan, held_out, out, seed)
    say("final forests on all people, exported")
    model = final_model(final_artifact(data, features, held_out, heads, plan, seed), out)
    return Ours(held_out, heads, cost, streamed, model)


def ours_48(seed: int, say: Say) -> HeadFigures:
    """Our forests on all 48 channels, people held out."""
    plan, data = TrainingPlan(), load(HUMAN, channels=48)
    features = features_of(data, spec_for(data, plan.groups))
    return held_out_figures(data, cross_validate(data, features, plan, seed=seed, say=say), seed)


def _row(name: str, seed: int, say: Say) -> HeadFigures:
    return ROWS[name](seed, say)


def _eflesh(seed: int, say: Say) -> EfleshStudy:
    return study_eflesh(load("eflesh_slip"), TrainingPlan(), seed)


def _proactive(seed: int, say: Say) -> list[ReplayPicture]:
    return study_proactive(load("proactive_slip_uskin"), TrainingPlan(), seed)


ROWS: dict[str, Callable[[int, Say], HeadFigures]] = {
    OURS_48: ours_48,
    "raw forest, 18 channels": lambda seed, say: baselines.raw_forest(load(HUMAN), seed=seed),
    "raw forest, 48 channels, 3 folds": lambda seed, say: baselines.raw_forest(
        load(HUMAN, channels=48), folds=3, seed=seed
    ),
    CLOCK: lambda seed, say: baselines.clock(load(HUMAN, channels=48), seed=seed),
    LEAKY: lambda seed, say: baselines.leaky(load(HUMAN), seed=seed),
}
"""Further rows of the table, by name: all 48 channels, the baselines and the two warnings."""


def verification_of(held_out: HeldOut) -> VerificationSums:
    """Sums over the folds of what export compared."""
    heads = [head for fold in held_out.verification for head in fold.heads.values()]
    plain = [head.predict_disagreement for head in heads if head.predict_disagreement]
    return VerificationSums(
        folds=len(held_out.verification),
        heldout_rows=sum(fold.given_rows for fold in held_out.verification),
        rows=sum(head.rows for head in heads),
        label_mismatches=sum(head.label_mismatches for head in heads),
        vote_mismatches=sum(head.vote_mismatches for head in heads),
        single_rows=sum(fold.single_rows for fold in held_out.verification),
        predict_disagreement_share=float(np.mean([one.share_off_ties for one in plain])),
        ties=sum(one.ties for one in plain),
    )


def final_model(artifact: Artifact, out: Path) -> FinalModel:
    """The file for the hand, from all people; it is not scored on its own training windows."""
    write_artifact(out / "human", artifact)
    path, report = export_artifact(out / "human")
    return FinalModel(str(path.relative_to(out)), report.bytes, report)


def main(argv: Sequence[str]) -> int:
    """Parse, run, write metrics.json, print the headline."""
    parser = Parser(
        prog="real.py", description="the whole main job on human_slip_uskin, eflesh_slip, proactive"
    )
    parser.add_argument("--out", type=path_argument, default=Path("build/real"), metavar="DIR")
    parser.add_argument("--seed", type=seed, default=0, metavar="S")
    add_job_options(parser, 2)
    args: argparse.Namespace = parser.parse_args(argv)
    require_writable(args.out)
    with stages(STAGES) as say:
        figures = run(args.out, args.seed, say, chosen_workers(args))
    text = json.dumps(figures.to_json(), indent=2, allow_nan=False)
    write_whole(args.out / "metrics.json", text + "\n")
    situations, head = figures.heads.situations, prediction_of(figures.heads)
    print(
        f"macro F1 {number(situations.macro_f1, 3)} ({interval(situations.macro_f1_ci, 3)}), "
        f"AUC {number(head.auc, 3)} ({interval(head.auc_ci, 3)})"
    )
    print(figures.caveat)
    print(f"{args.out / 'metrics.json'}, {args.out / 'report.html'} ({figures.seconds} s)")
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
