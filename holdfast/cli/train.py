"""`holdfast train --data SET .. --out DIR`: train on sets, write an artifact for export.

Without arguments it trains on the small generated fixture, into build/default. An artifact is
replaced only with --force.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    seed,
    show,
    show_found,
)
from holdfast.core.writing import require_writable

if TYPE_CHECKING:
    from holdfast.training.fitting import TrainingRequest

# As holdfast.training has them; repeated here so that --help need not import it.
WINDOWS = ("balanced", "dense", "thesis", "natural")
FEATURES = ("fixed", "pooled")
MODEL_SIZES = ("tiny", "default")
LEARNERS = ("forest", "network", "committee")
HELD_OUT_BY = ("person", "object", "trial")
DEFAULT_OUT = Path("build/default")


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
        help="artifact folder (default build/default)",
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace an artifact that is in DIR already",
    )
    _choose_recordings(parser)
    _choose_learner(parser)
    parser.add_argument(
        "--seed",
        type=seed,
        default=0,
        metavar="S",
        help="seed of every random choice (default 0)",
    )
    add_json_option(parser)
    parser.add_argument(
        "--report",
        type=path_argument,
        metavar="OUT",
        help="write a report (HTML): the held-out figure, with a learning curve",
    )


def _choose_recordings(parser: argparse.ArgumentParser) -> None:
    """The options of which recordings are read, and how they are held out."""
    parser.add_argument(
        "--groups", type=int, metavar="K", help="use K people (or blocks) only"
    )
    parser.add_argument(
        "--rate",
        type=positive,
        metavar="HZ",
        help="samples a second to learn at: recordings at 2 to 20 times this are averaged down "
        "(default: as recorded)",
    )
    parser.add_argument(
        "--hold-out",
        choices=HELD_OUT_BY,
        metavar="WHAT",
        help="what is held out together: person, object or trial "
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
        choices=FEATURES,
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


def run(args: argparse.Namespace) -> int:
    """Train; prints the windows and the held-out figures, and the stages on stderr."""
    from holdfast.core.contract import CANNOT_TELL, not_learned_in_words
    from holdfast.core.errors import command
    from holdfast.training.metrics import situation_lines, with_interval
    from holdfast.training.progress import Stages

    require_json_writable(args)
    # A report that cannot be written is refused before the training.
    if args.report is not None:
        require_writable(args.report.parent)

    progress = Stages()
    progress("loading the libraries")
    # Imported within the stage: loading the libraries takes seconds, and is shown.
    from holdfast.training.fitting import train_on_sets

    # With --json on stdout nothing else may stand there.
    describe = _quiet if args.json == STDOUT else show
    data, trained = train_on_sets(_request(args), progress, describe)
    figures = trained.figures
    if args.report is not None:
        from holdfast.evaluation.report import write_training_report

        progress("drawing the report")
        write_training_report(args.report, data, trained, args.out)

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
    lines += [data.caveat, f"artifact: {args.out}; next: {command('export', args.out)}"]

    found = {
        "artifact": args.out,
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


def _quiet(text: str) -> None:
    """What describes the sets where stdout is kept for JSON."""


def _request(args: argparse.Namespace) -> TrainingRequest:
    from holdfast.training.fitting import TrainingRequest

    return TrainingRequest(
        data=tuple(args.data),
        out=args.out,
        replace=args.force,
        groups=args.groups,
        hold_out=args.hold_out,
        rate_hz=args.rate,
        windows=args.windows,
        features=args.features,
        size=args.size,
        learner=args.learner,
        seed=args.seed,
        judge=args.report is not None,
    )
