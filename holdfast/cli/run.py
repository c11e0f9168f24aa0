"""`holdfast run [MODEL] --source URL`: reads a hand and answers every sample, until it is stopped.

holdfast run --source usb://ft232h
holdfast run --source "virtual://ft232h?scene=pull-soft-ball&seed=1" --view
holdfast run mine.onnx --source usb://ft232h --grip unix:///run/hand/grip
holdfast run mine.onnx --source usb://ft232h --engine c
holdfast run --source usb://ft232h --web 8000
"""

from __future__ import annotations

import argparse

from holdfast.cli.command import path_argument, positive
from holdfast.cli.options import (
    add_calibration_option,
    add_engine_options,
    add_grip_options,
    add_intent_option,
    add_obey_option,
    add_source_option,
    add_web_option,
    chosen_model,
    require_grip,
    require_intent,
    set_reader,
)
from holdfast.core.schema import DEFAULT_MODEL


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    model = f"a sealed holdfast.onnx (default: the shipped {DEFAULT_MODEL})"
    option("model", nargs="?", default=DEFAULT_MODEL, metavar="MODEL", help=model)
    add_source_option(parser)
    add_calibration_option(parser)
    add_engine_options(parser)
    option(
        "--out",
        type=path_argument,
        metavar="FILE",
        help="also write the JSON lines to FILE",
    )
    option("--udp", metavar="HOST:PORT", help="also send the JSON lines as datagrams")
    lsl = "also send values and decisions as the LSL streams NAME and NAME-decision"
    option("--lsl", metavar="NAME", help=lsl)
    commands = "receive the user's commands here: opening, and override of an alarm"
    option("--commands", metavar="URL", help=f"{commands} (unix:///PATH)")
    add_intent_option(parser)
    add_obey_option(parser)
    add_grip_options(parser)
    samples = "write the prepared samples to a CSV, for holdfast replay"
    option("--samples", type=path_argument, metavar="FILE", help=samples)
    option("--quiet", action="store_true", help="no JSON lines on stdout")
    view = "show the stream in the terminal, and no JSON lines there"
    option("--view", action="store_true", help=view)
    add_web_option(parser)
    bias = "file written by holdfast bias (default: from the first samples)"
    option("--bias", type=path_argument, metavar="FILE", help=bias)
    option(
        "--seconds",
        type=positive,
        metavar="S",
        help="stop after S seconds (default: Ctrl-C)",
    )


def run(args: argparse.Namespace) -> int:
    """Run until stopped; JSON lines on stdout, messages and the summary on stderr."""
    from holdfast.live.run import RunOptions, run

    # Options that contradict each other are refused before the hand is opened.
    require_grip(args)
    require_intent(args)
    options = RunOptions(
        model=chosen_model(args),
        source=args.source,
        calibration=args.calibration,
        bias=args.bias,
        seconds=args.seconds,
        quiet=args.quiet,
        out=args.out,
        udp=args.udp,
        lsl=args.lsl,
        samples=args.samples,
        view=args.view,
        web=args.web,
        commands=args.commands,
        intent=args.intent,
        obey_intent=args.obey_intent,
        grip=args.grip,
        controller=args.controller,
        ceiling=args.ceiling,
        feedback=args.feedback,
        cues=args.cues,
    )
    return run(options, set_reader(args.source))
