"""`python -m studies evaluate`: the default model on simulated sets that it never saw.

Every scored set has a locked seed (holdfast/core/locked.toml), which no choice has seen. One set
chooses thresholds, one trains the thesis' forest, which is a baseline; neither is scored.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

from holdfast.cli.command import path_argument
from holdfast.cli.main import main as holdfast
from holdfast.core.errors import DataNotFound
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from studies.real.events import write_real_events
from tools.harness import SimulatedSet, simulate_sets

MODEL = Path("models/holdfast-150hz.onnx")
TEXTURE = "thesis-texture"
"""The scene `thesis` on rough objects, which vibrate when they slip."""
SCORED = [
    SimulatedSet("thesis", "thesis", 900, 7000),
    SimulatedSet(TEXTURE, TEXTURE, 300, 7001),
    SimulatedSet("apple", "apple", 200, 7002),
    SimulatedSet("p1", "p1", 900, 7003),
    SimulatedSet("p2", "p2", 900, 7004),
    SimulatedSet("perturbed-hold", "perturbed-hold", 300, 7005),
    SimulatedSet("daily", "daily", 370, 7006),
    SimulatedSet("wide", "wide", 600, 7001),
]
CHOOSE = SimulatedSet("choose", "daily", 370, 107)
TRAIN = SimulatedSet("train", "thesis", 500, 108)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument("--model", type=path_argument, default=MODEL, metavar="FILE")
    parser.add_argument(
        "--real",
        type=path_argument,
        default=Path("build/real"),
        metavar="DIR",
        help="results of `make real`, evaluated too if they are there (default build/real)",
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N")


def run(args: argparse.Namespace) -> int:
    """Simulate the sets, score the model; figures.json and report.html.

    Where `make real` has left a fold, its events too: real.json and real.html.
    """
    rate_hz = Model(args.model).card.rate_hz
    simulate_sets(_sets(args.out, rate_hz), args.out)
    words = ["evaluate", str(args.model), "--data"]
    words += [str(args.out / one.folder) for one in SCORED]
    words += ["--choose", str(args.out / CHOOSE.folder)]
    words += ["--train", str(args.out / TRAIN.folder)]
    words += ["--jobs", str(args.jobs), "--seed", str(args.seed)]
    words += ["--json", str(args.out / "figures.json")]
    words += ["--report", str(args.out / "report.html")]
    code = holdfast(words)
    if code:
        return code
    try:
        print("\n".join(map(str, write_real_events(args.real, args.out, args.seed))))
    except DataNotFound as error:
        print(f"real recordings are not evaluated: {error}")
    return 0


def _sets(out: Path, rate_hz: float) -> list[SimulatedSet]:
    """All sets at the model's rate; the scene of the rough objects, no shipped one, is written."""
    scene = out / f"{TEXTURE}.toml"
    thesis = files("holdfast") / "simulation" / "cards" / "thesis.toml"
    out.mkdir(parents=True, exist_ok=True)
    write_whole(scene, thesis.read_text("utf-8") + "\n[effects.texture]\n")
    rough = SimulatedSet(TEXTURE, str(scene), 300, 7001)
    others = [one for one in SCORED if one.folder != TEXTURE]
    return [replace(one, rate_hz=rate_hz) for one in (*others, rough, CHOOSE, TRAIN)]
