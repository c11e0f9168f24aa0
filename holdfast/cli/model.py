"""From recordings to a model file: `holdfast train` and `holdfast export`.

`train --data SET .. --out DIR` writes an artifact and exports it: DIR/holdfast.onnx is ready to
run. Without arguments it trains on the small generated fixture, into build/default. An artifact is
replaced only with --force.

`export DIR --out FILE` turns an artifact into one verified, sealed file; without arguments
build/default. Nothing is written unless file and reference agree. A file in the artifact's folder
is derived from it and replaced; a file elsewhere is replaced only with --force. `--to c` turns a
sealed file into C99 instead (export/c). A model file is exported again with the same learner, for
another hand (--hand, of pooled features) or by other rules (--rule).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    CARD_SUFFIX,
    STDOUT,
    add_json_option,
    add_report_option,
    add_seed_option,
    path_argument,
    positive,
    require_outputs,
    show,
    show_found,
)
from holdfast.core.errors import UsageError, command, visible
from holdfast.core.schema import c_folder, model_path

if TYPE_CHECKING:
    from holdfast.core.hand_card import HandCard
    from holdfast.data.recording import HoldOut
    from holdfast.export.verify import HeadVerification
    from holdfast.training.fitting import TrainingRequest

# As holdfast.training has them; repeated here so that --help need not import it.
WINDOWS = ("balanced", "dense", "thesis", "natural")
MODEL_SIZES = ("tiny", "default")
LEARNERS = ("forest", "network", "committee")
HELD_OUT_BY: tuple[HoldOut, ...] = ("person", "object", "trial")
DEFAULT_OUT = Path("build/default")


# -- train


def _features(word: str) -> str:
    """One of the plans of holdfast.training, which is loaded when a run needs it."""
    from holdfast.training.plan import PLANS

    if word not in PLANS:
        raise argparse.ArgumentTypeError(f"{word!r}: choose {' or '.join(PLANS)}")
    return word


def add_train_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "--data",
        nargs="+",
        default=[],
        metavar="SET|FOLDER",
        help="sets by name or path (default: a small generated set, to try the command)",
    )
    parser.add_argument(
        "--out",
        type=path_argument,
        default=DEFAULT_OUT,
        metavar="DIR",
        help="folder of the artifact and of its model file (default build/default)",
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace an artifact that is in DIR already",
    )
    _choose_recordings(parser)
    _choose_learner(parser)
    add_seed_option(parser)
    add_json_option(parser)
    add_report_option(parser, "the held-out figure, with a learning curve")


def _choose_recordings(parser: argparse.ArgumentParser) -> None:
    """The options of which recordings are read, and how they are held out."""
    parser.add_argument(
        "--rate",
        type=positive,
        metavar="HZ",
        help="samples a second to learn at: recordings at 2 to 20 times this are averaged down "
        "(default: as recorded)",
    )
    parser.add_argument(
        "--hold-out",
        nargs="+",
        type=_held_out_by,
        default=[],
        metavar="[SET=]WHAT",
        help="what is held out together, of all sets or of one: person, object or trial "
        "(default: the first of these with which every model learns every situation)",
    )


def _choose_learner(parser: argparse.ArgumentParser) -> None:
    """The options of what is learned from which windows."""
    parser.add_argument(
        "--windows",
        choices=WINDOWS,
        default="balanced",
        metavar="WHICH",
        help="windows to train on: balanced (default), dense (closer where a phase begins), "
        "thesis (undersampled), natural",
    )
    parser.add_argument(
        "--features",
        type=_features,
        default="fixed",
        metavar="WHICH",
        help="features of sensors in fixed places (fixed, default), or pooled over the sensors of "
        "a side, with which a file can be exported for any hand card (pooled)",
    )
    parser.add_argument(
        "--size",
        choices=MODEL_SIZES,
        default="default",
        metavar="SIZE",
        help=f"size of the forest, also of one in a committee: {', '.join(MODEL_SIZES)}",
    )
    parser.add_argument(
        "--learner",
        choices=LEARNERS,
        default="committee",
        metavar="WHAT",
        help="what answers: forest, network, or committee (both; default; docs/how-it-works.md)",
    )


def _held_out_by(text: str) -> tuple[str, HoldOut]:
    """Name of the set, "" for all, and what is held out of it."""
    name, _, what = text.rpartition("=")
    for one in HELD_OUT_BY:
        if what == one:
            return name, one
    raise argparse.ArgumentTypeError(
        f"{what!r}; allowed: {', '.join(HELD_OUT_BY)}, or SET=WHAT"
    )


def run_train(args: argparse.Namespace) -> int:
    """Train; prints the windows and the held-out figures, and the stages on stderr."""
    from holdfast.core.contract import CANNOT_TELL, not_learned_in_words
    from holdfast.core.progress import Stages, ignored
    from holdfast.data.metrics import situation_lines, with_interval

    progress = Stages()
    progress("loading the libraries")
    # Imported within the stage: loading the libraries takes seconds, and is shown.
    from holdfast.export.exporting import MODEL_NAME, export_artifact
    from holdfast.step.artifact import INDEX
    from holdfast.training.fitting import train_on_sets

    model = args.out / MODEL_NAME
    require_outputs(args, args.out / INDEX, model, model.with_suffix(CARD_SUFFIX))
    # With --json on stdout nothing else may stand there.
    describe = ignored if args.json == STDOUT else show
    data, trained = train_on_sets(_request(args), progress, describe)
    figures = trained.figures
    if args.report is not None:
        from holdfast.evaluation.report import write_training_report

        progress("drawing the report")
        write_training_report(args.report, data, trained, args.out)

    # after the report, which took the work: a failed export is repeated by `holdfast export`
    progress("exporting")
    model, exported = export_artifact(args.out, report=progress)

    held_out = f"held out by {data.group_kind}: "
    not_learned = trained.cannot_tell
    macro_f1, *each_f1 = situation_lines(
        figures.situations, figures.group_kind, not_learned
    )
    lines = [held_out + macro_f1, *each_f1]
    if figures.predict_250ms is not None:
        ranking = figures.predict_250ms
        auc = with_interval(ranking.auc, ranking.auc_ci, figures.group_kind)
        lines.append(f"{held_out}0.25 s prediction AUC {auc}")

    lines += trained.not_held_out
    lines += not_learned_in_words(not_learned)
    lines += [data.caveat, _written(model, exported.bytes)]
    # where no fold could be judged, F1 is None
    if figures.situations.f1.get("risky_slip") != 0.0:
        hand = command("run", model, "--source", "usb://ft232h")
        lines.append(f"next: {command('doctor', model)}; with a hand: {hand}")
    else:
        lines.append(
            "next: record more slips: this model finds none (F1 of risky slip is 0)"
        )

    found = {
        "artifact": args.out,
        "model": model,
        "data": data.name,
        "kind": data.kind,
        "caveat": data.caveat,
        "held_out": figures.to_json(),
        "not_held_out": trained.not_held_out,
        CANNOT_TELL: not_learned,
        "learning_curve": [asdict(point) for point in trained.curve],
    }
    show_found(args, "\n".join(lines), found)
    return 0


def _request(args: argparse.Namespace) -> TrainingRequest:
    from holdfast.training.fitting import TrainingRequest

    return TrainingRequest(
        data=tuple(args.data),
        out=args.out,
        replace=args.force,
        hold_out=dict(args.hold_out),
        rate_hz=args.rate,
        windows=args.windows,
        features=args.features,
        size=args.size,
        learner=args.learner,
        seed=args.seed,
        judge=args.report is not None,
    )


# -- export


def add_export_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "artifact",
        nargs="?",
        type=path_argument,
        default=DEFAULT_OUT,
        metavar="DIR",
        help="artifact folder of holdfast train (default build/default); "
        "a model file with --to c, --hand or --rule, or an older one to be exported again",
    )
    parser.add_argument(
        "--to",
        choices=("onnx", "c"),
        default="onnx",
        help="the form to write (default onnx)",
    )
    parser.add_argument(
        "--hand",
        metavar="CARD",
        help="the hand the file is for: a hand card by name or path "
        "(default: the hand of the training recordings)",
    )
    parser.add_argument(
        "--rule",
        action="append",
        default=[],
        type=_rule,
        metavar="NAME=NUMBER",
        help="a rule of a model file's decision: min_risky_permille, evidence_ms, .. "
        "(docs/how-it-works.md); can be repeated",
    )
    parser.add_argument(
        "--out",
        type=path_argument,
        metavar="FILE",
        help="model file to write (default DIR/holdfast.onnx); "
        "with --to c a folder (default MODEL-c beside the model, where it is found again)",
    )
    parser.add_argument(
        "--force", action="store_true", help="replace FILE if it exists"
    )
    parser.add_argument(
        "--build",
        action=argparse.BooleanOptionalAction,
        help="with --to c: compile libholdfast.so (default: where there is a compiler)",
    )
    add_json_option(parser)


def _rule(text: str) -> tuple[str, int]:
    """Name and number of --rule."""
    name, _, number = text.partition("=")
    if not number.isdecimal():
        raise argparse.ArgumentTypeError("write NAME=NUMBER, such as evidence_ms=300")
    return name, int(number)


def run_export(args: argparse.Namespace) -> int:
    """Export; prints what was verified."""
    # the name of a shipped model, as every other command takes it
    args.artifact = model_path(args.artifact)
    if args.to == "c":
        if args.hand is not None or args.rule:
            raise UsageError(
                f"{'--hand' if args.hand else '--rule'} with --to c",
                next_step="export the model file that way first, then that file to C",
            )
        _report(f"exporting {args.artifact}")
        return _export_c(args)

    if args.build:
        raise UsageError("--build compiles C", next_step="add --to c")
    if args.artifact.suffix == ".onnx":
        return _export_again(args)
    if args.rule:
        raise UsageError(
            "--rule changes a model file", next_step="export the folder first"
        )
    from holdfast.export.exporting import (
        MODEL_NAME,
        export_artifact,
        require_replaceable,
    )

    # Before the export, whose work would be lost.
    model = args.out or args.artifact / MODEL_NAME
    require_replaceable(args.artifact, model, force=args.force)
    require_outputs(args, replaced=(model, model.with_suffix(CARD_SUFFIX)))
    _report(f"exporting {args.artifact}")
    hand = _hand(args)
    path, report = export_artifact(args.artifact, args.out, hand=hand, report=_report)
    lines = [f"{name}: {_agreement(head)}" for name, head in report.heads.items()]
    lines += [hand.in_words()] if hand else []
    lines += [
        "one at a time equals a batch, bit for bit: "
        f"{report.single_rows} rows and {report.stream_samples} samples",
        _written(path, report.bytes),
    ]
    show_found(args, "\n".join(lines), {"model": path, **asdict(report)})
    return 0


def _written(model: Path, n_bytes: int) -> str:
    """Two lines: the file, and the command for its C form."""
    words = ["export", model, "--to", "c", "--build"]
    # it is of the file that was replaced: a run refuses it until it is made again
    if c_folder(model).exists():
        words.append("--force")
    return (
        f"model: {model} ({n_bytes / 1e6:.1f} MB)\n"
        f"faster in C, where there is a compiler: {command(*words)}"
    )


def _hand(args: argparse.Namespace) -> HandCard | None:
    """The card of --hand. Raises CardError."""
    if args.hand is None:
        return None
    from holdfast.core.hand_card import read_hand_card

    return read_hand_card(args.hand)


def _report(line: str) -> None:
    sys.stderr.write(f"  {visible(line)}\n")


def _export_again(args: argparse.Namespace) -> int:
    """Export a model file again, with its learner: for another hand, by other rules."""
    from holdfast.edge_runtime.model_file import read_sealed
    from holdfast.export.changed import changed
    from holdfast.export.exporting import write_model

    if args.out is None or args.out.suffix != ".onnx":
        raise UsageError(
            "a model file is exported again into another file",
            next_step="name it: --out NEW.onnx",
        )
    require_outputs(args, args.out, args.out.with_suffix(CARD_SUFFIX))
    _report(f"exporting {args.artifact}")
    base = read_sealed(args.artifact)
    hand = _hand(args)
    data = changed(base, hand, dict(args.rule), args.artifact)
    write_model(args.out, data)
    lines = ["the same learner", _written(args.out, len(data))]
    if hand is not None:
        lines.insert(1, hand.in_words())
    show_found(args, "\n".join(lines), {"model": args.out, "bytes": len(data)})
    return 0


def _export_c(args: argparse.Namespace) -> int:
    """Export a sealed file as C; prints its memory and the result of the self-test."""
    from holdfast.export.c.exporting import ON_A_BOARD, export_c, folder_for

    # A folder of `holdfast train` or a model file: both are given as the first argument.
    model = args.artifact / "holdfast.onnx" if args.artifact.is_dir() else args.artifact
    folder = args.out or folder_for(model)
    done = export_c(model, folder, build=args.build, force=args.force)
    lines = [
        f"state {done.state_bytes} bytes, tables {done.table_bytes} bytes, "
        f"stack of a step about {done.stack_bytes} bytes",
        *(done.selftest or ["not compiled"]),
        "labels are those of the model file; numbers may differ from Python's in the last bits, "
        "which fuses products and sums where the processor can (FMA)",
        f"C: {folder} ({', '.join(done.files)})",
        f"on another machine, in a copy of this folder beside the model: {ON_A_BOARD}",
    ]
    show_found(args, "\n".join(lines), {"folder": folder, **asdict(done)})
    return 0


def _agreement(head: HeadVerification) -> str:
    """How a head of the file compares with the reference; a forest, with scikit-learn's predict."""
    labels = (
        f"{head.rows} rows, {head.label_mismatches} labels differ from the reference"
    )
    plain = head.predict_disagreement
    if plain is None:
        return labels
    agreement = f"{1.0 - plain.share_off_ties:.4%} ({plain.ties} ties)"
    return f"{labels}; agreement with scikit-learn predict: {agreement}"
