"""`holdfast watch --camera oak --tag-mm 10 --out DIR`: records video and tag tracks until Ctrl-C.

    holdfast watch --camera oak --tag-mm 9.96 --seconds 15 --out trials/7
    holdfast watch --camera drawn.frames.npz --out build/watched
    holdfast watch --onset trials/7 --action pull          a label in trials/7/events.jsonl
    holdfast watch --onset trials/p01/my-cup/pull/trial_1  of holdfast record: its phases too

--onset finds the onset of slip that a camera saw. The action decides what a slip means: pull, fall
and hold make it risky, pass and put-down safe.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, path_argument, positive, show_found
from holdfast.cli.options import add_camera_options
from holdfast.core.errors import TagError, UsageError, command
from holdfast.sessions.onset import ACTIONS, GROSS_MM, doubt, read_motion, write_label

if TYPE_CHECKING:
    from holdfast.drivers.camera.sources import FrameSource


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("--camera", metavar="oak|FILE", help="oak, or a .frames.npz")
    option("--out", type=path_argument, metavar="DIR", help="the trial's folder")
    add_camera_options(parser)
    option("--seconds", type=positive, metavar="S", help="oak: stop after S seconds")
    option(
        "--onset",
        type=path_argument,
        metavar="TRIAL",
        help="label a watched folder, with the following options; --tag-mm corrects the tags",
    )
    option(
        "--action",
        choices=ACTIONS,
        help="action of the trial (default: the name of its folder)",
    )
    option(
        "--gross-mm",
        type=positive,
        default=GROSS_MM,
        metavar="MM",
        help=f"distance of gross slip, above what the pads give (default {GROSS_MM:g})",
    )
    option(
        "--until",
        type=float,
        dest="until_s",
        metavar="S",
        help="search until S seconds, as before the hand opens",
    )
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Record, or label what was recorded."""
    if args.onset is not None:
        return _label(args)
    if args.camera is None or args.out is None:
        raise UsageError(
            "--camera and --out are needed", next_step="or --onset TRIAL for a label"
        )
    return _record(args)


def _record(args: argparse.Namespace) -> int:
    """Record until the frames end or the operator stops it; then check the tags.

    Raises TagError where the size of a tag is impossible; the recording is kept.
    """
    from holdfast.drivers.camera.graph import watch
    from holdfast.live.running import say, stop_signals

    source = _source(args)
    with stop_signals() as stopped:
        watched = watch(source, args.out, stopped=stopped)
    counts = f"{watched.frames} frames with tags read, {watched.in_video} in the video"
    words = f"{counts}, {watched.lost} lost between them\n"
    words += f"{args.out}; next: {command('watch', '--onset', args.out)}"
    found = {
        "out": args.out,
        "frames": watched.frames,
        "in_video": watched.in_video,
        "lost": watched.lost,
    }
    show_found(args, words, found)
    # After the recording is whole: a wrong size can be given again with --onset --tag-mm.
    wrong = doubt(args.out)
    if isinstance(wrong, TagError):
        raise wrong
    if wrong is not None:
        say(f"warning: {wrong}")
    return stopped.exit_code


def _source(args: argparse.Namespace) -> FrameSource:
    """The camera, or stored frames. Raises UsageError or a DataError."""
    from holdfast.drivers.camera.recording import Lens
    from holdfast.drivers.camera.sources import OAK, Oak, read_frames
    from holdfast.sessions.camera import CameraOptions

    options = CameraOptions(
        camera=args.camera,
        tag_mm=args.tag_mm,
        fps=args.fps,
        exposure_ms=args.exposure_ms,
    )
    options.require_camera()
    if args.camera == OAK:
        lens = Lens(**options.shooting(), clock="monotonic")
        return Oak(lens, args.seconds)

    return read_frames(Path(args.camera))


def _label(args: argparse.Namespace) -> int:
    """Find the onset, write it next to the trial, print it."""
    trial = read_motion(args.onset, args.tag_mm)
    if args.until_s is not None:
        trial = replace(trial, moved=trial.moved.until(args.until_s + trial.starts_s))
    words, found = write_label(trial, args.action, args.gross_mm)
    show_found(args, words, found)
    return 0
