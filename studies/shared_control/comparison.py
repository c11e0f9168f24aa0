"""`python -m studies loop SCENE..`: grip controllers in a closed loop on scenes, simulated."""

from __future__ import annotations

import argparse

from benchmarks.loop_figures import LoopFigures
from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    require_outputs,
    show_found,
)
from holdfast.cli.options import chosen_model, chosen_workers
from holdfast.core.errors import UsageError
from holdfast.core.progress import Stages
from studies.shared_control.closed_loop import LoopComparison
from studies.shared_control.loop_report import write_loop_report

LAG_MS = 50.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of a comparison alone."""
    option = parser.add_argument
    scenes = (
        "compare controllers on these scenes, by name or file, instead of the study"
    )
    option("scenes", nargs="*", metavar="SCENE", help=scenes)
    names = "scenes: grip controllers, vibration or oracle (default holdfast)"
    option("--controller", nargs="+", metavar="NAME", help=names)
    setting = "scenes: setting of the controllers (default: that of each)"
    option("--setting", type=positive, metavar="X", help=setting)
    lag = f"scenes: lag of the hand's drive (default {LAG_MS:g})"
    option("--lag-ms", type=_lag_ms, metavar="MS", help=lag)
    page = "scenes: write an HTML page with trials as they went by"
    option("--report", type=path_argument, metavar="OUT.html", help=page)
    add_json_option(parser)


def require_scenes(args: argparse.Namespace) -> None:
    """Raise UsageError where an option of a comparison stands without a scene."""
    given = {
        "controller": args.controller,
        "setting": args.setting,
        "lag-ms": args.lag_ms,
        "report": args.report,
        "json": args.json,
    }
    for option, value in given.items():
        if value is not None:
            raise UsageError(
                f"--{option} needs a scene to compare controllers on",
                next_step="python -m studies loop SCENE..",
            )


def run(args: argparse.Namespace) -> int:
    """Run, print a line a controller, write the figures."""
    require_outputs(args)
    lag_ms = LAG_MS if args.lag_ms is None else args.lag_ms
    comparison = LoopComparison(
        model=chosen_model(args),
        cards=tuple(args.scenes),
        controllers=tuple(args.controller or ["holdfast"]),
        setting=args.setting,
        lag_ms=lag_ms,
        opening=args.opening,
        trials=args.trials,
        seed=args.seed or 0,
    )
    # A card that does not fit the model is refused before the first trial is simulated.
    comparison.require_runnable()
    announced = f"running {', '.join(args.scenes)} in a closed loop (simulated)"
    progress = Stages()
    progress(announced)
    figures, runs = comparison.run(chosen_workers(args), progress.part)

    lines = []
    for card, rows in figures.items():
        lag = f"drive lag {lag_ms:g} ms"
        lines.append(f"{card}, {lag}, seed {comparison.seed} (simulated)")
        lines += [_in_words(name, one) for name, one in rows.items()]

    if args.report is not None:
        page = write_loop_report(args.report, comparison, figures, runs)
        lines.append(f"report: {page}")
    show_found(args, "\n".join(lines), comparison.to_json(figures))
    return 0


def _in_words(name: str, figures: LoopFigures) -> str:
    """One line of figures."""
    saved = f"{figures.saved} of {figures.preventable} preventable drops saved"
    of_all = figures.saved_of_drops
    saved += f" ({of_all.count} of all {of_all.of})"
    fresh = figures.saved_untightened
    saved += f", {fresh.count} of {fresh.of} without an earlier tightening"
    after = figures.held_after_opening
    blocked = f"{after.count} of {after.of} held after the wearer's opening"
    if figures.before_force_n_p95 is not None:
        before = f"{figures.before_force_n_p95:.1f} N and {figures.before_delay_ms_p95:.0f} ms"
        blocked += f", before it {before} more for a receiver (95 %)"
    blocked += f"; {figures.blocked} of {figures.handovers} hand-overs blocked"
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
