"""Train on sets, write an artifact for export: `training/train.py --data SET .. --out DIR`.

Without arguments it trains on the small generated fixture, into build/default, and may be run
again: an artifact of the fixture there is replaced. Every other artifact is replaced only with
--force. As a script it trains a forest, the thesis' learner, as `holdfast train` a committee.
"""

from __future__ import annotations

import sys
from pathlib import Path

# run as a script: the folder of the script is first on sys.path and shadows the rooms
if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[2])

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    path_argument,
    require_json_writable,
    run_script,
    seed,
    show,
    show_found,
)
from holdfast.core.errors import DataError, UsageError

if TYPE_CHECKING:
    from holdfast.training.figures import HeadFigures
    from holdfast.training.progress import Stages
    from holdfast.training.recording import DataSet

WINDOWS, MODEL_SIZES = ("balanced", "thesis", "natural"), ("tiny", "default", "best")
"""As training/windows.py and training/plan.py have them; here so that --help need not import
them."""
LEARNERS = ("forest", "network", "committee")
HELD_OUT_BY = ("person", "object", "trial")
DEFAULT_OUT = Path("build/default")
FIXTURE = "fixture"
MOST_STAGES = 9
"""Beside one a set: libraries, features, six folds, final forests."""
FIXTURE_TRIALS = 4
"""Trials a cell: enough windows for a forest to learn something, few enough for a minute of CI."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this command, also of `holdfast train`."""
    parser.add_argument(
        "--data",
        nargs="+",
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


def add_script_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the bare script: its learner is the thesis' forest unless another is named."""
    add_arguments(parser)
    parser.set_defaults(learner="forest")


def _choose_learner(parser: argparse.ArgumentParser) -> None:
    """The options of what is learned from which windows."""
    parser.add_argument(
        "--windows",
        choices=WINDOWS,
        default="balanced",
        metavar="WHICH",
        help="windows to train on: balanced (dense; default), thesis (undersampled), natural",
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
        help="what answers: forest, network, or committee (both; default; docs/learners.md)",
    )
    parser.add_argument(
        "--inner-folds",
        type=fold_count,
        default=0,
        metavar="K",
        help="choose label weights and network on K folds of the training groups (default: no)",
    )


def fold_count(word: str) -> int:
    """A number of folds from the command line: two or more."""
    number = int(word) if word.isdecimal() else 0
    if number < 2:
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number of 2 or more")
    return number


def _choose_recordings(parser: argparse.ArgumentParser) -> None:
    """The options of which recordings are read, and how they are held out."""
    parser.add_argument(
        "--channels", type=int, metavar="C", help="channels, where a set offers several"
    )
    parser.add_argument(
        "--groups", type=int, metavar="K", help="use K people (or blocks) only"
    )
    parser.add_argument(
        "--hold-out",
        choices=HELD_OUT_BY,
        metavar="WHAT",
        help="what is held out together: person (default with two or more), object, or trial",
    )


def run(args: argparse.Namespace) -> int:
    """Train; prints the windows and the held-out figures, and on stderr what it is about."""
    from holdfast.training.progress import stages
    from holdfast.training.summary import situation_lines, with_interval

    require_json_writable(args)
    folders = args.data or [str(args.out / FIXTURE)]
    with stages(len(folders) + MOST_STAGES) as say:
        say("loading the libraries")
        data, figures = _trained(args, folders, say)
    head = figures.predict_250ms
    macro_f1, *each_f1 = situation_lines(figures.situations, figures.group_kind)
    words = [f"held out by {data.group_kind}: {macro_f1}", *each_f1]
    if head is not None:
        auc = with_interval(head.auc, head.auc_ci, figures.group_kind)
        words.append(f"held out by {data.group_kind}: 0.25 s prediction AUC {auc}")
    words += [data.caveat, f"artifact: {args.out}; next: holdfast export {args.out}"]
    found = {
        "artifact": args.out,
        "data": data.name,
        "kind": data.kind,
        "caveat": data.caveat,
    }
    show_found(args, "\n".join(words), {**found, "held_out": figures.to_json()})
    return 0


def _trained(
    args: argparse.Namespace, folders: Sequence[str], say: Stages
) -> tuple[DataSet, HeadFigures]:
    """The set that was trained on, and the held-out figures."""
    from holdfast.core.writing import require_writable
    from holdfast.export.artifact import require_no_artifact
    from holdfast.training.datasets.joined import join
    from holdfast.training.fitting import train
    from holdfast.training.plan import hand_plan
    from holdfast.training.summary import warn_of_scarcity, windows_table

    require_writable(args.out)
    if not args.force and not _rebuilds_fixture(args):
        require_no_artifact(args.out)
    if not args.data:
        _write_fixture(args.out)
    plan = replace(hand_plan(args.size, args.learner), inner_folds=args.inner_folds)
    sets = []
    for folder in folders:
        say(f"reading {folder}")
        part = _read_set(folder, args, say)
        if args.json != STDOUT:
            count = f"{len(part.recordings)} recordings at {part.rate_hz:.4g} Hz"
            show(f"{part.name}: {part.kind}; {count}\n{windows_table(part)}")
        sets.append(part)
    data = join(sets)
    warn_of_scarcity(data, undersampled=args.windows == "thesis")
    return data, train(
        data, args.out, plan, seed=args.seed, say=say, part=say.part
    ).figures


def _read_set(folder: str, args: argparse.Namespace, say: Stages) -> DataSet:
    """One set, as the options say. Raises UsageError for its --channels, and a DataError."""
    from holdfast.training.datasets import load
    from holdfast.training.datasets.reading import ChannelsNotOffered

    try:
        return load(
            folder,
            channels=args.channels,
            groups=args.groups,
            seed=args.seed,
            windows=args.windows,
            hold_out=args.hold_out,
            part=say.part,
        )
    except ChannelsNotOffered as error:
        raise UsageError(
            f"--channels {args.channels}: {folder} does not have that many",
            next_step=f"give --channels {error.offered}, or leave it out",
        ) from None


def _rebuilds_fixture(args: argparse.Namespace) -> bool:
    """Whether this run without arguments replaces an artifact of the fixture."""
    from holdfast.core.objects import read_json
    from holdfast.export.artifact import INDEX
    from holdfast.training.fixture import KIND

    if args.data or args.out != DEFAULT_OUT:
        return False
    try:
        origin = read_json(args.out / INDEX).get("training")
    except DataError:
        return False
    return isinstance(origin, dict) and origin.get("kind") == KIND


def _write_fixture(out: Path) -> None:
    from holdfast.training.fixture import write_fixture

    write_fixture(out / FIXTURE, trials_per_cell=FIXTURE_TRIALS)


if __name__ == "__main__":
    sys.exit(run_script("train.py", str(__doc__), add_script_arguments, run))
