"""`holdfast evaluate MODEL --data SET`: the file itself answers on a labelled set, and is scored."""

from __future__ import annotations

import argparse
import json
from typing import Any

from edge_runtime.command import place, seed
from edge_runtime.monitor import Model
from edge_runtime.writing import require_writable, write_whole
from training.datasets import load
from training.evaluation import evaluate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument("--data", required=True, metavar="SET|FOLDER", help="a labelled set by name or path")
    parser.add_argument("--groups", type=int, metavar="K", help="use K people (or blocks) only")
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of the intervals and the choice of groups")
    parser.add_argument("--json", type=place, metavar="OUT", help="write the figures here")


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the figures in words, and write them as JSON."""
    if args.json is not None:
        require_writable(args.json.parent)
    model = Model(args.model)
    data = load(args.data, channels=model.card.n_channels, groups=args.groups, seed=args.seed, windows="natural")
    figures = evaluate(model, data, seed=args.seed)
    if args.json is not None:
        write_whole(args.json, json.dumps(figures, indent=2, allow_nan=False) + "\n")
    print("\n".join(in_words(figures)))
    return 0


def in_words(figures: dict[str, Any]) -> list[str]:
    """The figures as lines for people, with what must stand beside them."""
    situations = figures["situations"]
    lines = [
        f"{figures['data']} ({figures['kind']}): {figures['n_trials']} trials, {figures['n_groups']} groups",
        f"macro F1 over four situations  {_with_interval(situations['macro_f1'], situations['macro_f1_ci'])}",
    ]
    lines += [
        f"  F1 {name:<12} {_with_interval(value, situations['f1_ci'][name])}"
        for name, value in situations["f1"].items()
    ]
    if "predict_250ms" in figures:
        head = figures["predict_250ms"]
        lines.append(f"0.25 s prediction: AUC          {_with_interval(head['auc'], head['auc_ci'])}")
        lines.append(f"  average precision {_with_interval(head['average_precision'], head['average_precision_ci'])}")
    if figures["unknown_windows"]:
        lines.append(
            f"WARNING: the state is unknown at {figures['unknown_windows']} windows (lost or unsettled sensors); "
            "they count as misses."
        )
    if figures["trained_on_recordings"]:
        lines.append(
            f"WARNING: the model was trained on {figures['trained_on_recordings']} of these {figures['n_trials']} "
            "recordings; these figures flatter it. Held-out figures are in its card and in make real."
        )
    return [*lines, figures["caveat"]]


def _with_interval(value: float | None, interval: list[float] | None) -> str:
    if value is None:
        return "not defined (the class is absent)"
    return f"{value:.3f}" + (
        f"  (95 % interval over groups {interval[0]:.3f} to {interval[1]:.3f})" if interval else ""
    )
