"""What each feature group brings on unseen people, and its price: `make study NAME=ablation`.

Every row is a full cross-validation on human_slip_uskin, 18 channels: the default groups, each of
them left out, and each other group added. Gains are paired: the same people in every draw. A row
with a group of unlimited memory (the band-pass bank) is not clock-free and says so. The cost is the
median of a single step of the feature graph, all rows interleaved.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Collection
from dataclasses import asdict, replace

import numpy as np

from benchmarks.timed_calls import step_call
from holdfast.core.reading import Json
from holdfast.core.writing import require_writable, write_whole
from holdfast.evaluation.formats import markdown
from holdfast.evaluation.latency.timing import time_in_turns
from holdfast.export.features import GROUPS, feature_count, feature_graph
from holdfast.export.learner import LEARNERS
from holdfast.export.spec import StepSpec
from holdfast.training.crossval import HeldOut, cross_validate
from holdfast.training.datasets import load
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.figures import ABSENT
from holdfast.training.fitting import held_out_figures, versions
from holdfast.training.metrics import Gain, macro_f1_gain, prediction_gains
from holdfast.training.plan import LearnerKind, TrainingPlan
from holdfast.training.progress import Say, stages
from holdfast.training.recording import DataSet
from tools.harness import write_figures

HUMAN = "human_slip_uskin"
Rows = dict[str, tuple[str, ...]]
"""Row name -> feature groups."""
GAINED = ("macro_f1", "auc", "average_precision")


def rows_of(groups: tuple[str, ...], only: Collection[str] | None = None) -> Rows:
    """All defaults, each left out, each other one added; only: of these groups, None for all."""
    rows = {"default": groups}
    for name in GROUPS if only is None else only:
        if name in groups:
            rows[f"without {name}"] = tuple(group for group in groups if group != name)
        else:
            rows[f"with {name}"] = (*groups, name)
    return rows


def _plan(learner: LearnerKind) -> TrainingPlan:
    """The default plan, one network in place of four that differ in their seed alone."""
    plan = TrainingPlan(learner=learner)
    return replace(
        plan,
        network=replace(plan.network, members=1),
        prediction_network=replace(plan.prediction_network, members=1),
    )


def study_rows(
    data: DataSet, plan: TrainingPlan, rows: Rows, seed: int, say: Say
) -> dict[str, Json]:
    """Every row's figures, gains and cost; the first is the default."""
    specs = {name: spec_for(data, groups) for name, groups in rows.items()}
    costs = step_costs(specs)
    result = {}
    default = None
    for name, spec in specs.items():
        say(name)
        used = replace(plan, groups=spec.groups)
        held_out = cross_validate(data, features_of(data, spec), used, seed=seed)
        default = default or held_out
        figures = _figures(data, held_out, seed)
        gains = _gains(data, held_out, default, seed)
        finite = [math.isfinite(GROUPS[group].memory_s) for group in spec.groups]
        result[name] = {
            **costs[name],
            **figures,
            "features": feature_count(spec),
            "clock_free": all(finite),
            "gains": {figure: asdict(gain) for figure, gain in gains.items()},
        }
    return result


def _figures(data: DataSet, held_out: HeldOut, seed: int) -> Json:
    """What a choice of feature groups reaches on unseen people."""
    figures = held_out_figures(data, held_out, seed)
    head = figures.predict_250ms
    assert head is not None  # the set has that task
    return {
        "macro_f1": figures.situations.macro_f1,
        "macro_f1_ci": figures.situations.macro_f1_ci,
        **asdict(head),
    }


def _gains(
    data: DataSet, ours: HeldOut, default: HeldOut, seed: int
) -> dict[str, Gain]:
    """Over the default's figures, paired: the same people in every draw."""
    situations = data.tasks["situations"]
    head = data.tasks["predict_250ms"]
    people = data.group_of("predict_250ms")
    our_score = ours.shares("predict_250ms")[:, 1]
    their_score = default.shares("predict_250ms")[:, 1]
    auc, precision = prediction_gains(
        head.label, our_score, their_score, people, seed=seed
    )
    macro_f1 = macro_f1_gain(
        situations.label,
        ours.situations(),
        default.situations(),
        data.group_of("situations"),
        seed=seed,
    )
    return {"macro_f1": macro_f1, "auc": auc, "average_precision": precision}


def step_costs(specs: dict[str, StepSpec]) -> dict[str, Json]:
    """Nodes of each feature graph, and us of one of its steps: B = 1, all graphs interleaved."""
    models = {name: feature_graph(spec) for name, spec in specs.items()}
    calls = {}
    for name, spec in specs.items():
        sample = np.linspace(0.0, 1.0, spec.n_channels)[None]
        calls[name] = step_call(models[name].SerializeToString(), sample)
    costs = {}
    for name, times in time_in_turns(calls).items():
        nodes = len(models[name].graph.node)
        costs[name] = {"nodes": nodes, "us": float(np.median(times))}
    return costs


HEADS = {
    "groups": "groups",
    "features": "features",
    "macro_f1": "macro F1 (gain, 95 %)",
    "auc": "AUC (gain, 95 %)",
    "average_precision": "average precision (gain, 95 %)",
    "nodes": "nodes",
    "us": "us a step (more)",
    "clock_free": "clock-free",
}


def gains_table(rows: Json) -> str:
    """The rows of ablation.json as a Markdown table; gains are over the default."""
    base_us = rows["default"]["us"]
    lines = [_line(name, row, base_us) for name, row in rows.items()]
    return markdown(
        [{head: line[key] for key, head in HEADS.items()} for line in lines]
    )


def _line(name: str, row: Json, base_us: float) -> Json:
    return {
        "groups": name,
        "features": row["features"],
        **{figure: _with_gain(row[figure], row["gains"][figure]) for figure in GAINED},
        "nodes": row["nodes"],
        "us": f"{row['us']:.1f} ({row['us'] - base_us:+.1f})",
        "clock_free": "yes" if row["clock_free"] else "NO",
    }


def _with_gain(value: float | None, gain: Json) -> str:
    """A figure, and what it gains with its interval."""
    if value is None or gain["value"] is None:
        return ABSENT
    if not gain["ci"]:
        return f"{value:.3f} ({gain['value']:+.3f})"
    low, high = gain["ci"]
    return f"{value:.3f} ({gain['value']:+.3f}, {low:+.3f} to {high:+.3f})"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument(
        "--learner", choices=LEARNERS, default="committee", metavar="WHAT"
    )
    parser.add_argument(
        "--groups",
        nargs="+",
        choices=GROUPS,
        metavar="GROUP",
        help="rows of these groups only",
    )


def run(args: argparse.Namespace) -> int:
    """Write ablation.json and ablation.md, print the table."""
    require_writable(args.out)
    plan = _plan(args.learner)
    data = load(HUMAN)
    chosen = rows_of(plan.groups, args.groups)
    with stages(len(chosen)) as say:
        rows = study_rows(data, plan, chosen, args.seed, say)
    result = {
        "data": HUMAN,
        "learner": args.learner,
        "caveat": data.caveat,
        "seed": args.seed,
        "versions": versions(),
        "rows": rows,
    }
    write_figures(args.out / "ablation.json", result)
    text = gains_table(result["rows"])
    write_whole(args.out / "ablation.md", text)
    print(text + data.caveat)
    return 0
