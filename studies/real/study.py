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
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from edge_runtime.command import Parser, finish, path_argument, seed
from edge_runtime.writing import require_writable, write_whole
from evaluation.cells import interval, number
from evaluation.provenance import host
from export.artifact import Artifact, write_artifact
from export.exporting import export_artifact
from studies.real import baselines
from studies.real.eflesh import study_eflesh
from studies.real.figures import FinalModel, RealStudy, VerificationSums, prediction_of
from studies.real.proactive import study_proactive
from studies.real.report import Evidence, write_report
from studies.real.streamed_fold import stream_one_fold
from studies.row_names import CLOCK, LEAKY, OURS_18, OURS_48
from training.crossval import HeldOut, cross_validate
from training.datasets import load
from training.featurise import cpu_cost, features_of, spec_for
from training.figures import HeadFigures
from training.fitting import final_artifact, held_out_figures, versions
from training.plan import TrainingPlan
from training.progress import stages
from training.recording import DataSet
from training.say import Say

HUMAN = "human_slip_uskin"
CLOCK_FREE = (
    "no feature sees anything older than 0.5 s; time, movement indices and IMUs are never inputs"
)
STAGES = 24
"""Lines the progress bar expects; a wrong number only makes the bar end early or late."""


def run(out: Path, seed: int, say: Say) -> RealStudy:
    """Do everything and write the report; returns what metrics.json holds."""
    started = time.perf_counter()
    plan = TrainingPlan()
    say(f"reading {HUMAN}")
    data = load(HUMAN)
    spec = spec_for(data, plan.groups)
    features = features_of(data, spec)
    held_out = cross_validate(data, features, plan, seed=seed, say=say, verify_spec=spec)
    ours = held_out_figures(data, held_out, seed)
    cost = cpu_cost(data, spec)
    say("one fold's file, sealed, loaded and streamed sample by sample")
    streamed = stream_one_fold(data, features, plan, held_out, out, seed)
    rows = table_rows(data, ours, plan, seed, say)
    say("eflesh_slip: blocks held out")
    eflesh = study_eflesh(load("eflesh_slip"), plan, seed)
    say("proactive_slip_uskin: two slips replayed")
    pictures = study_proactive(load("proactive_slip_uskin"), plan, seed)
    say("final forests on all people, exported")
    model = final_model(final_artifact(data, features, held_out, ours, plan, seed), out)
    figures = RealStudy(
        heads=ours,
        data=data.name,
        kind=data.kind,
        channels=18,
        clock_free=CLOCK_FREE,
        caveat=data.caveat,
        verification=verification_of(held_out),
        features_cost=cost,
        streamed_fold=streamed,
        rows=rows,
        eflesh_slip=eflesh.figures,
        model=model,
        seed=seed,
        host=host(),
        versions=versions(),
        seconds=round(time.perf_counter() - started, 1),
    )
    say("report")
    write_report(out / "report.html", Evidence(data, held_out, figures, eflesh, pictures))
    return figures


def table_rows(
    data: DataSet, ours: HeadFigures, plan: TrainingPlan, seed: int, say: Say
) -> dict[str, HeadFigures]:
    """Every row of the table: our forests, the baselines and the two warnings."""
    say("all 48 channels")
    everything = load(HUMAN, channels=48)
    features = features_of(everything, spec_for(everything, plan.groups))
    wide = held_out_figures(
        everything, cross_validate(everything, features, plan, seed=seed, say=say), seed
    )
    rows = {OURS_18: ours, OURS_48: wide}
    say("baseline: raw windows, 18 channels")
    rows["raw forest, 18 channels"] = baselines.raw_forest(data, seed=seed)
    say("baseline: raw windows, 48 channels, fewer folds")
    rows["raw forest, 48 channels, 3 folds"] = baselines.raw_forest(everything, folds=3, seed=seed)
    say("timing-only baseline")
    rows[CLOCK] = baselines.clock(everything, seed=seed)
    say("leaky split: windows split at random")
    rows[LEAKY] = baselines.leaky(data, seed=seed)
    return rows


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
    args: argparse.Namespace = parser.parse_args(argv)
    require_writable(args.out)
    with stages(STAGES) as say:
        figures = run(args.out, args.seed, say)
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
