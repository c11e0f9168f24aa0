"""`holdfast watch --camera oak --tag-mm 10 --out DIR`: records video and tag tracks until Ctrl-C.

holdfast watch --camera oak --tag-mm 9.96 --seconds 15 --out trials/7
holdfast watch --camera drawn.frames.npz --out build/watched
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, path_argument, positive, show_found
from holdfast.cli.options import add_apart_option, add_camera_options
from holdfast.core.errors import TagError

if TYPE_CHECKING:
    from holdfast.drivers.camera.sources import FrameSource


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    cameras = "oak, or a .frames.npz"
    option("--camera", required=True, metavar="oak|FILE", help=cameras)
    option(
        "--out",
        type=path_argument,
        required=True,
        metavar="DIR",
        help="the trial's folder",
    )
    add_camera_options(parser)
    add_apart_option(parser)
    option("--seconds", type=positive, metavar="S", help="oak: stop after S seconds")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Record until the frames end or the operator stops it; then check the tags.

    Raises TagError where the size of a tag is impossible; the recording is kept.
    """
    from holdfast.drivers.camera.graph import watch
    from holdfast.live.running import say, stop_signals
    from holdfast.sessions.onset import doubt

    source = _source(args)
    with stop_signals() as stopped:
        watched = watch(source, args.out, stopped=stopped)
    counts = f"{watched.frames} frames with tags read, {watched.in_video} in the video"
    words = f"{counts}, {watched.lost} lost between them\n"
    words += f"{args.out}; next: holdfast onset {args.out}"
    found = {
        "frames": watched.frames,
        "in_video": watched.in_video,
        "lost": watched.lost,
    }
    show_found(args, words, {"out": args.out, **found})
    # After the recording is whole: a wrong size can be given again with `holdfast onset --tag-mm`.
    wrong = doubt(args.out)
    if isinstance(wrong, TagError):
        raise wrong
    if wrong is not None:
        say(f"warning: {wrong}")
    return 0


def _source(args: argparse.Namespace) -> FrameSource:
    """The camera, or stored frames. Raises UsageError or a DataError."""
    from holdfast.drivers.camera.recording import Lens
    from holdfast.drivers.camera.sources import OAK, Oak, read_frames
    from holdfast.sessions.camera import CameraOptions

    options = CameraOptions(args.camera, args.tag_mm, args.fps, args.exposure_ms)
    # Options that do not fit the camera are refused before it is opened.
    options.require_complete(args.seconds)
    if args.camera == OAK:
        lens = Lens(**options.shooting(), clock="monotonic", apart_mm=args.apart_mm)
        return Oak(lens, args.seconds)

    return read_frames(Path(args.camera), args.apart_mm)
