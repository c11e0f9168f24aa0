"""`holdfast simulate CARD --out DIR`: a card's trials in the thesis' layout, with their truth."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    require_json_writable,
    seed,
    show_found,
)
from holdfast.core.errors import count_of, visible
from holdfast.simulation import shipped_scenes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "card",
        metavar="CARD",
        help=f"a TOML file, or one of {', '.join(shipped_scenes())}",
    )
    option(
        "--out", type=path_argument, required=True, metavar="DIR", help="a new folder"
    )
    trials = "number of trials, in the card's proportions (default: all)"
    option("--trials", type=trial_count, metavar="N", help=trials)
    option(
        "--rate", type=float, metavar="HZ", help="sampling rate (default: the card's)"
    )
    every = "seed of every random choice (default 0)"
    option("--seed", type=seed, default=0, metavar="S", help=every)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Simulate and write; the same card and seed give the same bytes.

    An interrupted run leaves no folder.
    """
    from holdfast.core.locked import lock_of
    from holdfast.simulation.folder import require_new, write_set
    from holdfast.simulation.scene import Scene
    from holdfast.simulation.scene_file import read_scene_file
    from holdfast.training.progress import counted

    require_json_writable(args)
    # A set is made of one card and one seed; files of two sets must not mix.
    require_new(args.out)
    file = read_scene_file(args.card, rate_hz=args.rate, rate_option="--rate ")
    scene = Scene(file, args.seed)
    total = len(scene.trials(args.trials))
    card = scene.file
    announced = f"simulating {count_of(total, 'trial')} of {card.name}"
    # The handlers are set first, so that no signal falls between.
    with _nothing_left_of(args.out), counted(announced, total) as done:
        files = write_set(scene, args.out, args.trials, done)

    found = {
        "kind": "simulated",
        "card": card.name,
        "title": card.title,
        "recordings": files,
        "rate_hz": card.rate_hz,
        "seed": args.seed,
        "locked": lock_of(args.out),
        "out": args.out,
    }
    show_found(args, _in_words(found), found)
    return 0


def _in_words(found: Mapping[str, Any]) -> str:
    rate = f"{count_of(found['recordings'], 'recording')} at {found['rate_hz']:g} Hz"
    next_step = f"next: holdfast train --data {found['out']} --out build/model"
    if found["locked"]:
        next_step = f"for a last test, not to train or choose on: {found['locked']}"
    return f"{found['title']}\n{rate}, simulated, seed {found['seed']}; {next_step}"


@contextmanager
def _nothing_left_of(out: Path) -> Iterator[None]:
    """SIGTERM and SIGHUP end the block as Ctrl-C does, so that it removes its unfinished folder."""

    def interrupt(number: int, frame: object) -> None:
        # As Ctrl-C: the block that writes the folder removes it, whatever ends the run.
        raise KeyboardInterrupt

    before: dict[signal.Signals, Any] = {}
    for number in (signal.SIGTERM, signal.SIGHUP):
        # a signal that nohup or a service manager ignores stays ignored
        if signal.getsignal(number) != signal.SIG_IGN:
            before[number] = signal.signal(number, interrupt)

    try:
        yield
    except KeyboardInterrupt:
        sys.stderr.write(
            f"{visible(str(out))} is not written: the unfinished folder is removed\n"
        )
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def trial_count(word: str) -> int:
    """A number of trials, from a word of the command line."""
    number = int(word) if word.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number from 1")
    return number
