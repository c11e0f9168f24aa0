"""`python -m studies models`: make a shipped file anew, from scenes and the lifts of ten people.

With `--scenes` it learns from scenes alone and has another name, so that it is not mistaken for
the shipped one.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from holdfast.cli.command import path_argument, positive
from holdfast.cli.main import main as holdfast
from holdfast.data.datasets.grip_lift_ati import NAME as LIFTS
from studies.model_sets import training_sets


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program alone."""
    parser.add_argument("--rate", type=positive, default=150.0, metavar="HZ")
    parser.add_argument("--size", choices=("tiny", "default"), default="default")
    parser.add_argument(
        "--scenes", action="store_true", help="from scenes alone, without people"
    )
    parser.add_argument(
        "--models",
        type=path_argument,
        default=Path("models"),
        metavar="DIR",
        help="folder of the file (default models)",
    )


def run(args: argparse.Namespace) -> int:
    """Simulate the sets that are missing in the folder of results, train, and write the file."""
    sets = training_sets(args.out, args.rate, lifts=not args.scenes)
    name = f"holdfast-{args.rate:g}hz"
    name += "-tiny" if args.size == "tiny" else ""
    name += "-scenes" if args.scenes else ""
    hold_out = ["trial"] if args.scenes else ["trial", f"{LIFTS}=person"]
    words = ["train", "--data", *sets, "--features", "pooled", "--windows", "dense"]
    words += ["--hold-out", *hold_out, "--size", args.size]
    words += ["--seed", str(args.seed), "--out", str(args.out / name), "--force"]
    code = holdfast(words)
    if code:
        return code
    args.models.mkdir(parents=True, exist_ok=True)
    model = args.models / f"{name}.onnx"
    words = ["export", str(args.out / name), "--force", "--out", str(model)]
    return holdfast(words)
