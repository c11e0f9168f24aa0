"""The widest scene: what its draws are, and what the shipped model makes of it, by action.

`python -m studies wide --seed 7001` is the locked set; seeds 100 to 199 are for development.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from holdfast.cli.command import path_argument
from holdfast.core.reading import Json, model_path
from holdfast.edge_runtime.model import Model
from tools.harness import (
    SimulatedSet,
    measured_now,
    run_holdfast,
    simulate_sets,
    write_figures,
)

TRIALS = 600
SCENE = "wide"
FOLDER = "set"
PERCENT = (5, 50, 95)
HEADLINE = "ours, as deployed"
ROW = (
    "events",
    "recall",
    "recall_ci",
    "false_per_min",
    "false_per_min_ci",
    "minutes",
    "safe_acts_called",
    "safe_acts_by_action",
    "with_enough_time",
    "by_action",
)
"""Figures of the headline's row that are kept."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    parser.add_argument("--trials", type=int, default=TRIALS, metavar="N")
    model = model_path("holdfast-150hz")
    parser.add_argument("--model", type=path_argument, default=model, metavar="FILE")


def run(args: argparse.Namespace) -> int:
    """Simulate, evaluate, and write wide.json."""
    rate_hz = Model(args.model).card.rate_hz
    one = SimulatedSet(FOLDER, SCENE, args.trials, args.seed, rate_hz)
    simulate_sets([one], args.out)
    evaluated = args.out / "evaluated.json"
    words = ["evaluate", args.model, "--data", args.out / FOLDER, "--json", evaluated]
    run_holdfast([list(map(str, words))])
    write_figures(args.out / "wide.json", figures_of(args.out / FOLDER, evaluated))
    return 0


def figures_of(folder: Path, evaluated: Path) -> Json:
    """What the set is, and the shipped model's figures on it."""
    found = json.loads(evaluated.read_text("utf-8"))
    (scored,) = found["sets"].values()
    row = scored["rows"][HEADLINE]
    model = {name: row[name] for name in ROW}
    meta = json.loads((folder / "meta.json").read_text("utf-8"))
    return {
        **measured_now(),
        "model_id": found["model"]["model_id"],
        "seed": meta["seed"],
        "card_sha256": meta["card_sha256"],
        "draws": meta["draws"],
        "scene": _actions(folder),
        "model": model,
    }


def _actions(folder: Path) -> Json:
    """By action: trials, drops, slips, time before gross slip, friction used, grip."""
    of: dict[str, list[Json]] = {}
    for path in sorted(folder.rglob("*.truth.json")):
        truth = json.loads(path.read_text("utf-8"))
        of.setdefault(truth["action"], []).append(truth)
    return {action: _action(of[action]) for action in sorted(of)}


def _action(truths: Sequence[Json]) -> Json:
    slipped = [one for one in truths if _slips(one)]
    firm = [one for one in truths if not one["supported"]]
    used = [one["drawn"]["used"] for one in firm if "used" in one["drawn"]]
    leads_s = []
    for one in slipped:
        if one["gross_slip_s"] is not None and one["load_onset_s"] is not None:
            leads_s.append(one["gross_slip_s"] - one["load_onset_s"])
    return {
        "trials": len(truths),
        "with_risky_slip": len(slipped),
        "slips_with_15_ms": sum(lead >= 0.015 for lead in leads_s),
        "lost_in_a_slip": sum(_lost(one) for one in slipped),
        "friction_used_percentiles": _percentiles(used),
        "grip_n_percentiles": _percentiles([one["grip_n"] for one in truths]),
    }


def _slips(truth: Json) -> bool:
    return any(phase["label"] == "risky_slip" for phase in truth["phases"])


def _lost(truth: Json) -> bool:
    """Whether the object leaves the hand out of a slip, and is not handed over."""
    *_, before, last = truth["phases"]
    return bool(before["label"] == "risky_slip" and last["label"] == "nothing")


def _percentiles(values: Sequence[float]) -> list[float] | None:
    if not values:
        return None
    return [round(float(one), 3) for one in np.percentile(values, PERCENT)]
