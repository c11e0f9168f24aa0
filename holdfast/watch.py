"""`holdfast watch --camera oak --tag-mm 10 --out DIR`: lossless video and tag tracks of a trial,
until Ctrl-C.

    holdfast watch --camera oak --tag-mm 9.96 --seconds 15 --out trials/7
    holdfast watch --camera build/scenes/soft-ball/pull/trial_1.frames.npz --out build/watched
    holdfast watch --camera trials/7 --out build/again            the tags anew, from a recorded video
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from edge_runtime.command import path_argument, positive, show
from edge_runtime.errors import TagError, UsageError
from holdfast.camera_options import add_camera_options, stored

if TYPE_CHECKING:
    from drivers.camera.sources import Source


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "--camera",
        required=True,
        metavar="oak|FILE",
        help="oak, a .frames.npz, or a recorded folder",
    )
    parser.add_argument(
        "--out", type=path_argument, required=True, metavar="DIR", help="the trial's folder"
    )
    add_camera_options(parser)
    parser.add_argument(
        "--apart-mm",
        type=positive,
        metavar="MM",
        help="between the tags' centres at first: a check",
    )
    parser.add_argument("--seconds", type=positive, metavar="S", help="oak: stop after so long")


def run(args: argparse.Namespace) -> int:
    """Watch until the frames end or somebody stops it; then say what the tags contradict.

    Raises TagError where a size cannot be; what was recorded is there all the same.
    """
    from drivers.camera.graph import watch
    from drivers.camera.sources import OAK, Lens, Oak
    from holdfast.messages import say
    from holdfast.onset import doubt
    from holdfast.stopping import stop_signals

    source: Source
    if args.camera == OAK:
        if args.tag_mm is None:
            raise UsageError(
                "--tag-mm is missing",
                cause="millimetres come from the printed side",
                next_step="measure a tag's black square with a calliper and give --tag-mm 9.96",
            )
        source = Oak(
            Lens(args.fps, args.exposure_ms, args.tag_mm, "monotonic", args.apart_mm), args.seconds
        )
    else:
        source = stored(Path(args.camera), say)
        if args.apart_mm is not None:
            source.lens = replace(source.lens, apart_mm=args.apart_mm)
    with stop_signals() as stopped:
        watched = watch(source, args.out, say=say, stopped=stopped)
    print(
        f"{watched.frames} frames with tags read, {watched.in_video} in the video, {watched.lost} lost between them"
    )
    show(f"{args.out}; next: holdfast onset {args.out}")
    wrong = doubt(args.out)
    if isinstance(wrong, TagError):
        raise wrong
    if wrong is not None:
        say(f"warning: {wrong}")
    return 0
