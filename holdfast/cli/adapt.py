"""`holdfast adapt MODEL --data FOLDER --person p01 --out FILE`: a model file for one person.

    holdfast record --source URL --out trials --person p01 --protocol simulation/cards/adapt.toml
    holdfast adapt models/holdfast-150hz.onnx --data trials --person p01 --out p01.onnx
    holdfast adapt p01.onnx --undo --out base.onnx

An adapted file is adapted again from the base in it, so adaptations never add up. docs/adapt.md
says what is fitted, and on what.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    require_json_writable,
    show_found,
)
from holdfast.core.errors import OutputError, UsageError
from holdfast.core.writing import require_writable, write_whole

if TYPE_CHECKING:
    from holdfast.edge_runtime.model import Model
    from holdfast.export.adapted_file import AdaptedVerification
    from holdfast.sessions.adapting import Fitted
    from holdfast.training.progress import Stages
    from holdfast.training.recording import DataSet

STAGES = 7


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("model", type=path_argument, metavar="MODEL", help="a sealed model file")
    data = "recordings of the person: eight hand-overs and a minute of holding"
    option("--data", metavar="FOLDER", help=data)
    option("--person", metavar="PSEUDONYM", help="whose recordings in FOLDER")
    slips = "recordings with slips, of any person (default: simulated trials)"
    option("--slips", metavar="SET|FOLDER", help=slips)
    out = "model file to write; its card is written beside it"
    option("--out", type=path_argument, required=True, metavar="FILE", help=out)
    option(
        "--undo",
        action="store_true",
        help="write the base of an adapted file, byte for byte",
    )
    option("--force", action="store_true", help="replace FILE if it exists")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Adapt, or undo; prints what was chosen and verified."""
    _require_options(args)
    require_writable(args.out.parent)
    require_json_writable(args)
    return _undo(args) if args.undo else _adapt(args)


def _require_options(args: argparse.Namespace) -> None:
    """Raise UsageError or OutputError before anything long begins."""
    from holdfast.edge_runtime.model_file import CARD_SUFFIX

    if args.undo and (args.data or args.person or args.slips):
        raise UsageError(
            "--undo takes no --data, --person or --slips",
            next_step="leave these options out",
        )
    if not args.undo and not (args.data and args.person):
        raise UsageError(
            "--data and --person are needed",
            next_step="holdfast adapt MODEL --data FOLDER --person p01 --out FILE",
        )
    if args.out.suffix == CARD_SUFFIX:
        raise UsageError(
            f"--out {args.out}: the model's card is written there",
            next_step=f"write --out {args.out.with_suffix('.onnx')}",
        )
    if args.out.resolve() == args.model.resolve() or (
        args.out.exists() and not args.force
    ):
        raise OutputError(
            "exists already",
            where=args.out,
            cause="it is MODEL, or an earlier adaptation",
            next_step="name a new file with --out, or add --force to replace an adaptation",
        )


def _undo(args: argparse.Namespace) -> int:
    from holdfast.edge_runtime.model_file import read_sealed
    from holdfast.export.adapted_file import undone

    base = undone(read_sealed(args.model), args.model)
    _write(args.out, base)
    words = f"base: {args.out}, as it was before it was adapted"
    show_found(args, words, {"base": args.out})
    return 0


def _adapt(args: argparse.Namespace) -> int:
    from holdfast.training.progress import stages

    with stages(STAGES) as say:
        say("loading the libraries and the model")
        fitted, verified = _adapted(args, say)
    reached, person = fitted.point.reached, fitted.adaptation.about["person"]
    rules = fitted.point.rules
    words = (
        f"based on {person['hand_overs']} hand-overs and {person['holding_s']:.0f} s of holding\n"
        f"an act needs {rules.min_risky_permille} of 1000 votes, {rules.act_samples} in a row\n"
        f"trials held out: {reached.called} of {reached.hand_overs} hand-overs called, recall "
        f"{reached.recall:.3f} on slips of others\n"
        f"{verified.rows} rows checked, 0 labels differ from the reference; "
        f"{verified.changed} labels differ from the base\n"
        f"model: {args.out}; back: holdfast adapt {args.out} --undo --out BASE.onnx"
    )
    found = {
        "model": args.out,
        "person": person,
        "rules": rules.to_json(),
        "held_out": asdict(reached),
        "verified": asdict(verified),
    }
    show_found(args, words, found)
    return 0


def _adapted(
    args: argparse.Namespace, say: Stages
) -> tuple[Fitted, AdaptedVerification]:
    """Fit, build, verify and write."""
    from holdfast.export.adapted_file import adapted, verify_adapted
    from holdfast.sessions.adapting import adapt, base_model, of_person
    from holdfast.training.datasets import load

    with base_model(args.model) as (model, base):
        say("reading the person's recordings")
        channels = model.card.n_channels
        data = of_person(
            load(args.data, channels=channels, windows="none"), args.person
        )
        fitted = adapt(model, data, lambda: _slips(args, model, say), say, say.part)
    say("building, verifying and sealing the file")
    correction, rows = fitted.adaptation.correction, fitted.rows()
    made = adapted(base, fitted.adaptation)
    verified = verify_adapted(base, made, model.card, correction, rows)
    _write(args.out, made)
    return fitted, verified


def _slips(args: argparse.Namespace, model: Model, say: Stages) -> DataSet:
    from holdfast.sessions.adapting import simulated_slips
    from holdfast.training.datasets import load

    if args.slips:
        say(f"reading {args.slips}")
        return load(
            args.slips, channels=model.card.n_channels, windows="none", part=say.part
        )
    say("simulating trials with slips")
    return simulated_slips(model.card, part=say.part)


def _write(path: Path, data: bytes) -> None:
    """The file, and its card beside it."""
    from holdfast.edge_runtime.model import read_model
    from holdfast.edge_runtime.model_file import CARD_SUFFIX
    from holdfast.export.exporting import readable_card

    card, _, _ = read_model(data, path)
    write_whole(path, data)
    write_whole(path.with_suffix(CARD_SUFFIX), readable_card(card.raw, path.name, data))
