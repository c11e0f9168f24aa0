"""`make ablation`: what each feature group brings on unseen people, and its microseconds.

Every row is a full cross-validation on human_slip_uskin, 18 channels: the default groups, each of
them left out, and each other group added. A row with a group of unlimited memory (the band-pass
bank) is not clock-free and says so. The cost is the median of a single step of the feature graph,
all rows interleaved.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from edge_runtime.command import Parser, finish, path_argument, seed
from edge_runtime.graph import StepGraph, open_session
from edge_runtime.reading import Json
from edge_runtime.timing import time_in_turns
from edge_runtime.writing import require_writable, write_whole
from export.features import GROUPS, feature_count
from export.spec import StepSpec
from export.step_graph import feature_graph
from training.crossval import cross_validate
from training.datasets import load
from training.featurise import features_of, spec_for
from training.figures import ABSENT, Interval
from training.fitting import held_out_figures, versions
from training.plan import TrainingPlan
from training.progress import stages
from training.recording import DataSet
from training.say import Say

HUMAN = "human_slip_uskin"


def rows_of(groups: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Row name -> feature groups: all defaults, each left out, each other one added."""
    rows = {"default": groups}
    rows |= {f"without {name}": tuple(g for g in groups if g != name) for name in groups}
    return rows | {f"with {name}": (*groups, name) for name in GROUPS if name not in groups}


@dataclass(frozen=True)
class StepCost:
    """Nodes of a feature graph, and the median of one of its steps, us."""

    nodes: int
    us: float


@dataclass(frozen=True)
class AblationRow:
    """What a choice of feature groups reaches on unseen people, and what it costs."""

    cost: StepCost
    macro_f1: float | None
    macro_f1_ci: Interval | None
    auc: float | None
    auc_ci: Interval | None
    features: int
    clock_free: bool

    def to_json(self) -> Json:
        """As it stands in ablation.json."""
        fields = asdict(self)
        return fields.pop("cost") | fields


def run(data: DataSet, plan: TrainingPlan, seed: int, say: Say) -> dict[str, AblationRow]:
    """Every row's figures and cost."""
    rows = rows_of(plan.groups)
    specs = {name: spec_for(data, groups) for name, groups in rows.items()}
    costs = step_costs(specs)
    result = {}
    for name, spec in specs.items():
        say(name)
        used = replace(plan, groups=spec.groups)
        held_out = cross_validate(data, features_of(data, spec), used, seed=seed)
        figures = held_out_figures(data, held_out, seed)
        assert figures.predict_250ms is not None  # the set has that task
        result[name] = AblationRow(
            cost=costs[name],
            macro_f1=figures.situations.macro_f1,
            macro_f1_ci=figures.situations.macro_f1_ci,
            auc=figures.predict_250ms.auc,
            auc_ci=figures.predict_250ms.auc_ci,
            features=feature_count(spec),
            clock_free=all(math.isfinite(GROUPS[group].memory_s) for group in spec.groups),
        )
    return result


def step_costs(specs: dict[str, StepSpec]) -> dict[str, StepCost]:
    """One step of each feature graph, B = 1, all graphs interleaved."""
    models = {name: feature_graph(spec) for name, spec in specs.items()}
    calls = {name: _stepper(model.SerializeToString()) for name, model in models.items()}
    medians = {name: float(np.median(times)) for name, times in time_in_turns(calls).items()}
    return {name: StepCost(len(models[name].graph.node), medians[name]) for name in specs}


def _stepper(model: bytes) -> Callable[[], object]:
    graph = StepGraph(open_session(model))
    graph.sample[:] = np.linspace(0.0, 1.0, graph.sample.shape[1])
    return graph.step


def table(rows: dict[str, AblationRow]) -> str:
    """The rows as a Markdown table, differences against the default."""
    base = rows["default"]
    lines = [
        "| groups | features | macro F1 | AUC 0.25 s | nodes | us a step | clock-free |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        us = row.cost.us
        lines.append(
            f"| {name} | {row.features} | {_beside(row.macro_f1, base.macro_f1)} "
            f"| {_beside(row.auc, base.auc)} | {row.cost.nodes} "
            f"| {us:.1f} ({us - base.cost.us:+.1f}) | {'yes' if row.clock_free else 'NO'} |"
        )
    return "\n".join(lines) + "\n"


def _beside(value: float | None, base: float | None) -> str:
    """A figure, and how far it is from the default's."""
    if value is None or base is None:
        return ABSENT
    return f"{value:.3f} ({value - base:+.3f})"


def main(argv: Sequence[str]) -> int:
    """Parse, run, write ablation.json and ablation.md, print the table."""
    parser = Parser(
        prog="ablation.py", description="what each feature group brings, and what it costs"
    )
    parser.add_argument("--out", type=path_argument, default=Path("build/ablation"), metavar="DIR")
    parser.add_argument("--seed", type=seed, default=0, metavar="S")
    args = parser.parse_args(argv)
    require_writable(args.out)
    plan, data = TrainingPlan(), load(HUMAN)
    with stages(len(rows_of(plan.groups))) as say:
        rows = run(data, plan, args.seed, say)
    result = {
        "data": HUMAN,
        "caveat": data.caveat,
        "seed": args.seed,
        "versions": versions(),
        "rows": {name: row.to_json() for name, row in rows.items()},
    }
    write_whole(args.out / "ablation.json", json.dumps(result, indent=2) + "\n")
    write_whole(args.out / "ablation.md", table(rows))
    print(table(rows) + data.caveat)
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
