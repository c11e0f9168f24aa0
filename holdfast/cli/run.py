"""`holdfast run [MODEL] --source URL`: reads a hand and answers every sample, until it is stopped.

holdfast run --source usb://ft232h
holdfast run --source "virtual://ft232h?scene=pull-soft-ball&seed=1" --to view
holdfast run mine.onnx --source usb://ft232h --grip unix:///run/hand/grip
holdfast run mine.onnx --source usb://ft232h --engine onnxruntime
holdfast run --source usb://ft232h --to web:8000 --to today.jsonl

What is of a hand and seldom changes stands in holdfast.toml (cli/settings.py).
"""

from __future__ import annotations

import argparse

from holdfast.cli.command import path_argument, positive
from holdfast.cli.options import (
    add_calibration_option,
    add_engine_option,
    add_source_option,
    add_wearer_option,
    set_reader,
)
from holdfast.core.schema import DEFAULT_MODEL
from holdfast.edge_runtime.engine import AUTO

IN_SETTINGS = "holdfast.toml (docs/deploy.md)"
OLD_OPTIONS = {
    "--out": "--to FILE.jsonl",
    "--samples": "--to FILE.csv",
    "--udp": "--to udp://HOST:PORT",
    "--lsl": "--to lsl://NAME",
    "--view": "--to view",
    "--web": "--to web[:[HOST:]PORT]",
    "--quiet": "--to none",
    "--commands": '--wearer URL, which takes words such as {"wants":"open"}',
    "--intent": "--wearer URL",
    "--obey-intent": "--wearer URL, whose `open` counts",
    "--controller": f'controller = ".." in {IN_SETTINGS}',
    "--ceiling": f"ceiling_n = 40.0 in {IN_SETTINGS}",
    "--feedback": f'feedback = "URL" in {IN_SETTINGS}',
    "--cues": f'cues = "FILE" in {IN_SETTINGS}',
    "--library": f'library = "FILE" in {IN_SETTINGS}',
}
"""An option of earlier versions -> what to write instead."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    model = f"a sealed holdfast.onnx (default: the shipped {DEFAULT_MODEL})"
    option("model", nargs="?", default=DEFAULT_MODEL, metavar="MODEL", help=model)
    add_source_option(parser)
    to = (
        "where answers go, as often as wanted: - (JSON lines on stdout, the default), "
        "FILE.jsonl, FILE.csv (samples), view, web[:PORT], lsl://NAME, udp://HOST:PORT, none"
    )
    option("--to", action="append", metavar="URL", help=to)
    grip = (
        "send a grip command at every sample to unix:///PATH or serial:///dev/ttyX?baud=115200, "
        "or to the hand in a scene, by the word virtual (--source virtual://..?scene=..)"
    )
    option("--grip", metavar="URL", help=grip)
    add_wearer_option(parser)
    add_calibration_option(parser)
    bias = "file written by holdfast bias (default: from the first samples)"
    option("--bias", type=path_argument, metavar="FILE", help=bias)
    add_engine_option(parser, AUTO)
    seconds = "stop after S seconds (default: Ctrl-C)"
    option("--seconds", type=positive, metavar="S", help=seconds)


def run(args: argparse.Namespace) -> int:
    """Run until stopped; answers to --to, messages and the summary on stderr."""
    from holdfast.edge_runtime.engine import ONNXRUNTIME, ModelChoice
    from holdfast.live.run import RunOptions, run

    settings = args.settings
    library = None if args.engine == ONNXRUNTIME else settings.library
    options = RunOptions(
        model=ModelChoice(str(args.model), args.engine, library),
        source=args.source,
        to=tuple(args.to or settings.to),
        grip=args.grip,
        wearer=args.wearer,
        calibration=args.calibration,
        bias=args.bias,
        seconds=args.seconds,
        controller=settings.controller,
        ceiling_n=settings.ceiling_n,
        feedback=settings.feedback,
        cues=path_argument(settings.cues) if settings.cues else None,
    )
    return run(options, set_reader(args.source))
