"""`holdfast run` answers every sample of a hand until it is stopped; `replay` those of a recording.

holdfast run --source usb://ft232h
holdfast run --source "virtual://ft232h?scene=falling-bottle" --to view
holdfast run mine.onnx --source usb://ft232h --grip unix:///run/hand/grip
holdfast run mine.onnx --source usb://ft232h --engine onnxruntime
holdfast run --source usb://ft232h --to web:8000 --to today.jsonl
holdfast replay holdfast-150hz trials/p01/cup/pull/trial_1

What is of a hand and seldom changes stands in holdfast.toml (cli/options.py).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from holdfast.cli.command import path_argument
from holdfast.cli.options import (
    add_engine_option,
    add_hand_options,
    add_model_argument,
    add_seconds_option,
    add_wearer_option,
    set_reader,
)
from holdfast.edge_runtime.engine import AUTO
from holdfast.live.output_table import ABOUT


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    add_model_argument(parser)
    add_hand_options(parser)
    option(
        "--to",
        action="append",
        metavar="URL",
        help=f"where answers go, as often as wanted: {ABOUT}",
    )
    option(
        "--grip",
        metavar="URL",
        help="send a grip command at every sample to unix:///PATH or serial:///dev/ttyX?baud=N, "
        "or to the hand in a scene, by the word virtual (--source virtual://..)",
    )
    add_wearer_option(parser)
    option(
        "--bias",
        type=path_argument,
        metavar="FILE",
        help="file written by holdfast bias (default: from the first samples)",
    )
    add_engine_option(parser, AUTO)
    add_seconds_option(parser, "stop after S seconds (default: Ctrl-C)")


def run_run(args: argparse.Namespace) -> int:
    """Run until stopped; answers to --to, messages and the summary on stderr."""
    from holdfast.live.run import RunOptions, run

    values = dict(args.settings)
    for name, value in vars(args).items():
        if name in RunOptions.__struct_fields__ and value:
            values[name] = value
    return run(RunOptions(**values), args.seconds, set_reader(args.source))


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument(
        "trial",
        metavar="TRIAL",
        help="a trial's CSV or folder, SET#N, or sim://CARD?trial=N",
    )


def run_replay(args: argparse.Namespace) -> int:
    """Replay the whole trial to stdout, one JSON line a sample.

    Raises DataError, and ChannelError, UnitError, RateError where trial and model differ.
    """
    from holdfast.core.contract import not_learned_in_words
    from holdfast.edge_runtime.monitor import (
        GripMonitor,
        Model,
        require_fit,
        require_measured,
    )
    from holdfast.live.outputs import to_json_line
    from holdfast.live.running import say
    from holdfast.live.sources import open_source

    model = Model(args.model)
    card = model.card
    source = open_source(
        args.trial,
        channels=card.n_channels,
        read_set=set_reader(args.trial),
    )
    require_measured(card, source.hand, args.trial)
    source = replace(source, values=card.filler()(source.values))
    source = source.at_rate(card.rate_hz, say).prepared(card.preparation)
    # Before the first answer, so that stdout holds either answers of this trial or nothing.
    require_fit(
        card,
        n_channels=source.values.shape[1],
        unit=source.unit,
        rate_hz=source.rate_hz,
        where=args.trial,
    )
    # Without a clock: an answer of a replay is never late.
    monitor = GripMonitor(model, None, bias_known=source.zero == "measured")
    not_learned = card.not_learned
    for line in not_learned_in_words(not_learned):
        sys.stderr.write(f"{line}\n")
    for sample in source:
        sys.stdout.write(to_json_line(monitor.feed(sample), not_learned) + "\n")
    return 0
