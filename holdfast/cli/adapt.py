"""`holdfast adapt MODEL --data FOLDER --person p01 --slips FOLDER --out FILE`: for one person.

    holdfast record --source URL --out trials --person p01 --protocol simulation/cards/adapt.toml
    holdfast simulate thesis --trials 300 --seed 1 --out slips
    holdfast adapt models/holdfast-150hz.onnx --data trials --person p01 --slips slips --out p.onnx
    holdfast adapt p.onnx --undo --out base.onnx

docs/recording-and-study.md says what is fitted, and on what.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    CARD_SUFFIX,
    add_json_option,
    add_out_option,
    path_argument,
    require_outputs,
    show_found,
)
from holdfast.core.errors import UsageError, command

if TYPE_CHECKING:
    from holdfast.sessions.adapt import HeldOutFigures


def add_adapt_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("model", type=path_argument, metavar="MODEL", help="a sealed model file")
    option(
        "--data",
        metavar="FOLDER",
        help="recordings of the person: eight hand-overs and a minute of holding",
    )
    option("--person", metavar="PSEUDONYM", help="whose recordings in FOLDER")
    option(
        "--slips",
        metavar="SET|FOLDER",
        help="recordings with slips, of any person, such as simulated ones",
    )
    add_out_option(parser, "model file to write; its card goes next to it", "FILE")
    option(
        "--undo",
        action="store_true",
        help="write the base of an adapted file, byte for byte",
    )
    option(
        "--force",
        action="store_true",
        help="replace FILE if it exists, and write it although it is no better than its base",
    )
    add_json_option(parser)


def run_adapt(args: argparse.Namespace) -> int:
    """Adapt, or undo; prints what was chosen and verified."""
    # All that can be refused is refused before the fitting.
    _require_options(args)
    return _undo(args) if args.undo else _adapt(args)


def _require_options(args: argparse.Namespace) -> None:
    """Raise UsageError or OutputError before anything long begins."""
    given = (args.data, args.person, args.slips)
    if any(given) if args.undo else not all(given):
        raise UsageError(
            "--data, --person and --slips are needed, or --undo alone",
            next_step="holdfast adapt MODEL --data FOLDER --person p01 --slips FOLDER --out FILE",
        )

    require_outputs(args, args.out, args.out.with_suffix(CARD_SUFFIX))


def _undo(args: argparse.Namespace) -> int:
    from holdfast.sessions.adapt import write_base

    write_base(args.model, args.out)
    words = f"base: {args.out}, as it was before it was adapted"
    show_found(args, words, {"base": args.out})
    return 0


def _adapt(args: argparse.Namespace) -> int:
    from holdfast.core.progress import Stages

    begin = Stages()
    begin("loading the libraries and the model")
    from holdfast.sessions.adapt import adapt_file

    made = adapt_file(
        args.model,
        args.data,
        args.person,
        args.slips,
        args.out,
        begin,
        worse_too=args.force,
    )

    person = made.person
    reached = made.point.reached
    rules = made.point.rules
    words = (
        f"based on {person.hand_overs} hand-overs and {person.holding_s:.0f} s of holding\n"
        f"an act needs {rules.min_risky_permille} of 1000 votes, {rules.act_samples} in a row\n"
        f"trials held out: {_in_words(reached)}\n"
        f"the base on these: {_in_words(made.base)}\n"
        f"{made.verified.rows} rows checked, 0 labels differ from the reference; "
        f"{made.verified.changed} labels differ from the base\n"
        f"model: {args.out}; back: "
        + command("adapt", args.out, "--undo", "--out", "BASE.onnx")
    )
    found = {
        "model": args.out,
        "person": asdict(person),
        "rules": rules.to_json(),
        "held_out": asdict(reached),
        "base_held_out": asdict(made.base),
        "worse_than_base": reached.no_better_than(made.base),
        "verified": asdict(made.verified),
    }
    show_found(args, words, found)
    return 0


def _in_words(figures: HeldOutFigures) -> str:
    called = f"{figures.called} of {figures.hand_overs} voluntary actions called"
    if not figures.slips:
        return f"{called}, recall {figures.recall:.3f} on slips of others"
    own = f"{figures.found} of {figures.slips} slips of the person found"
    return f"{called}, {own}, recall {figures.recall:.3f} on these and those of others"
