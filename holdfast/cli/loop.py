"""`holdfast loop CARD..`: grip controllers in a closed loop on cards, simulated."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    seed,
    show_found,
)
from holdfast.cli.options import (
    add_engine_options,
    add_job_options,
    chosen_model,
    chosen_workers,
)
from holdfast.cli.simulate import trial_count

if TYPE_CHECKING:
    from holdfast.evaluation.loop_figures import LoopFigures

MODEL = Path("holdfast-150hz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("cards", nargs="+", metavar="CARD", help="scene cards, by name or file")
    option(
        "--model",
        type=path_argument,
        default=MODEL,
        metavar="FILE",
        help=f"default {MODEL}",
    )
    add_engine_options(parser)
    names = "grip controllers, vibration or oracle (default holdfast)"
    option("--controller", nargs="+", default=["holdfast"], metavar="NAME", help=names)
    setting = "setting of the controllers (default: that of each)"
    option("--setting", type=positive, metavar="X", help=setting)
    lag = "lag of the hand's drive (default 50)"
    option("--lag-ms", type=_lag_ms, default=50.0, metavar="MS", help=lag)
    option(
        "--trials", type=trial_count, metavar="N", help="trials a card (default: all)"
    )
    option(
        "--seed",
        type=seed,
        default=0,
        metavar="S",
        help="seed of every choice (default 0)",
    )
    add_job_options(parser, 2)
    page = "write an HTML page with trials as they went by (needs the extra viz)"
    option("--report", type=path_argument, metavar="OUT.html", help=page)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run, print a line a controller, write the figures."""
    from holdfast.core.writing import require_writable
    from holdfast.evaluation.closed_loop import LoopComparison
    from holdfast.training.progress import counted

    require_json_writable(args)
    if args.report is not None:
        require_writable(args.report.parent)
    comparison = LoopComparison(
        model=chosen_model(args),
        cards=tuple(args.cards),
        controllers=tuple(args.controller),
        setting=args.setting,
        lag_ms=args.lag_ms,
        trials=args.trials,
        seed=args.seed,
    )
    # A card that does not fit the model is refused before the first trial is simulated.
    comparison.require_runnable()
    announced = f"running {', '.join(args.cards)} in a closed loop (simulated)"
    with counted(announced, 1) as done:
        figures, runs = comparison.run(chosen_workers(args), done)

    lines = []
    for card, rows in figures.items():
        lag = f"drive lag {args.lag_ms:g} ms"
        lines.append(f"{card}, {lag}, seed {args.seed} (simulated)")
        lines += [_in_words(name, one) for name, one in rows.items()]

    if args.report is not None:
        from holdfast.evaluation.loop_report import write_loop_report

        page = write_loop_report(args.report, comparison, figures, runs)
        lines.append(f"report: {page}")
    show_found(args, "\n".join(lines), comparison.to_json(figures))
    return 0


def _in_words(name: str, figures: LoopFigures) -> str:
    """One line of figures."""
    saved = f"{figures.saved} of {figures.preventable} preventable drops saved"
    of_all = figures.saved_of_drops
    saved += f" ({of_all.count} of all {of_all.of})"
    blocked = f"{figures.blocked} of {figures.handovers} hand-overs blocked"
    grip = f"grip {figures.grip_excess:.2f} N s above need a trial"
    return f"  {name:<13}{saved}, {blocked}, {grip}"


def _lag_ms(word: str) -> float:
    try:
        lag = float(word)
    except ValueError:
        lag = -1.0
    if not 0.0 <= lag <= 1000.0:
        raise argparse.ArgumentTypeError(f"{word!r} is not a lag from 0 to 1000 ms")
    return lag
