"""`holdfast loop CARD..`: grip controllers in a closed loop on cards, simulated."""

from __future__ import annotations

import argparse
from collections.abc import Callable
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
    from holdfast.evaluation.closed_loop import LoopFigures

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
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run, print a line a controller, write the figures."""
    from holdfast.training.progress import counted

    _require_runnable(args)
    with counted(
        f"running {', '.join(args.cards)} in a closed loop (simulated)", 1
    ) as done:
        sets = _figures(args, done)
    words = []
    for card, rows in sets.items():
        words.append(
            f"{card}, drive lag {args.lag_ms:g} ms, seed {args.seed} (simulated)"
        )
        words += [in_words(name, figures) for name, figures in rows.items()]
    show_found(args, "\n".join(words), _json(args, sets))
    return 0


def _require_runnable(args: argparse.Namespace) -> None:
    """Raise what would stop a run, before it is announced."""
    from holdfast.evaluation.closed_loop import CHOICES, require_runnable
    from holdfast.simulation.closed_loop import model_of

    require_json_writable(args)
    require_known(args.controller, CHOICES)
    model = model_of(chosen_model(args))
    for card in args.cards:
        require_runnable(model, card)


def _figures(
    args: argparse.Namespace, done: Callable[[float], None]
) -> dict[str, dict[str, LoopFigures]]:
    from holdfast.evaluation.closed_loop import LoopRequest, LoopRuns, LoopSet

    runs = LoopRuns(chosen_model(args), chosen_workers(args), done)
    wanted = []
    for card in args.cards:
        one = LoopSet(card, args.trials, args.seed)
        for name in args.controller:
            wanted.append((one, LoopRequest(name, args.setting, args.lag_ms)))
    runs.run(wanted)
    sets: dict[str, dict[str, LoopFigures]] = {}
    for one, request in wanted:
        rows = sets.setdefault(Path(one.card).stem, {})
        rows[request.name] = runs.figures(one, request)
    return sets


def require_known(names: list[str], known: tuple[str, ...]) -> None:
    """Raise UsageError for a controller that does not exist."""
    from holdfast.core.errors import UsageError

    for name in names:
        if name not in known:
            raise UsageError(
                f"--controller {name!r:.40} does not exist",
                next_step=f"choose from {', '.join(known)}",
            )


def _json(
    args: argparse.Namespace, sets: dict[str, dict[str, LoopFigures]]
) -> dict[str, object]:
    from holdfast.simulation.closed_loop import model_of

    figures = {}
    for card, rows in sets.items():
        figures[card] = {name: one.to_json() for name, one in rows.items()}
    return {
        "kind": "simulated",
        "model": model_of(chosen_model(args)).card.model_id,
        "engine": args.engine,
        "lag_ms": args.lag_ms,
        "seed": args.seed,
        "trials": args.trials,
        "setting": args.setting,
        "sets": figures,
    }


def in_words(name: str, figures: LoopFigures) -> str:
    """One line of figures."""
    saved = f"{figures.saved} of {figures.preventable} preventable drops saved"
    blocked = f"{figures.blocked} of {figures.handovers} hand-overs blocked"
    return f"  {name:<13}{saved}, {blocked}, grip {figures.grip_excess:.2f} N s above need a trial"


def _lag_ms(word: str) -> float:
    try:
        lag = float(word)
    except ValueError:
        lag = -1.0
    if not 0.0 <= lag <= 1000.0:
        raise argparse.ArgumentTypeError(f"{word!r} is not a lag from 0 to 1000 ms")
    return lag
