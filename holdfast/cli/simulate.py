"""`holdfast simulate CARD --out DIR`: a card's trials in the thesis' layout, with their truth."""

from __future__ import annotations

import argparse
import signal

from holdfast.cli.command import (
    add_json_option,
    add_out_option,
    add_seed_option,
    require_outputs,
    show_found,
    whole,
)
from holdfast.core.errors import count_of
from holdfast.core.writing import require_new
from holdfast.simulation import shipped_scenes


def add_simulate_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "card",
        metavar="CARD",
        help=f"a TOML file, or one of {', '.join(shipped_scenes())}",
    )
    add_out_option(parser)
    option(
        "--trials",
        type=whole(1),
        metavar="N",
        help="number of trials, in the card's proportions (default: all)",
    )
    option(
        "--rate", type=float, metavar="HZ", help="sampling rate (default: the card's)"
    )
    add_seed_option(parser)
    add_json_option(parser)


def run_simulate(args: argparse.Namespace) -> int:
    """Simulate and write; the same card and seed give the same bytes.

    An interrupted run leaves no folder.
    """
    from holdfast.core.locked import lock_of
    from holdfast.core.progress import Stages
    from holdfast.simulation.scenes.folder import write_set
    from holdfast.simulation.scenes.scene import Scene
    from holdfast.simulation.scenes.scene_file import read_scene_file

    # A set is made of one card and one seed; files of two sets must not mix.
    require_new(args.out)
    require_outputs(args, folder=args.out)
    card = read_scene_file(args.card, rate_hz=args.rate)
    scene = Scene(card, args.seed)
    total = len(scene.trials(args.trials))
    for number in (signal.SIGTERM, signal.SIGHUP):
        # As Ctrl-C, which removes the unfinished folder; under nohup SIGHUP stays ignored.
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    progress = Stages()
    progress(f"simulating {count_of(total, 'trial')} of {card.name}")
    files = write_set(
        scene, args.out, args.trials, lambda done: progress.part(done / total)
    )

    locked = lock_of(args.out)
    found = {
        "kind": "simulated",
        "card": card.name,
        "title": card.title,
        "recordings": files,
        "rate_hz": card.rate_hz,
        "seed": args.seed,
        "locked": locked,
        "out": args.out,
    }
    next_step = f"next: holdfast train --data {args.out} --out build/model"
    if locked:
        next_step = f"for a last test, not to train or choose on: {locked}"
    rate = f"{count_of(files, 'recording')} at {card.rate_hz:g} Hz"
    words = f"{card.title}\n{rate}, simulated, seed {args.seed}; {next_step}"
    show_found(args, words, found)
    return 0
