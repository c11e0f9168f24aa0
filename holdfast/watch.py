"""`holdfast watch --camera oak --tag-mm 10 --out DIR`: lossless video and tag tracks of a trial, until Ctrl-C.

    holdfast watch --camera oak --tag-mm 9.96 --seconds 15 --out trials/7
    holdfast watch --camera build/scenes/soft-ball/pull/trial_1.frames.npz --out build/watched
    holdfast watch --camera trials/7 --out build/again            the tags anew, from a recorded video
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from edge_runtime.command import path_argument, positive
from edge_runtime.errors import TagError, UsageError

if TYPE_CHECKING:
    from drivers.camera.sources import Source

FPS, EXPOSURE_MS = 60.0, 2.0
SIDE_MM = (1.0, 200.0)
"""No tag beside a hand is smaller or larger: what is, is no millimetre."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("--camera", required=True, metavar="oak|FILE", help="oak, a .frames.npz, or a recorded folder")
    parser.add_argument("--out", type=path_argument, required=True, metavar="DIR", help="the trial's folder")
    parser.add_argument("--tag-mm", type=printed_mm, metavar="MM", help="oak: the printed side of the tags, measured")
    parser.add_argument("--apart-mm", type=positive, metavar="MM", help="between the tags' centres at first: a check")
    parser.add_argument("--fps", type=positive, default=FPS, metavar="HZ", help=f"oak: default {FPS:g}")
    parser.add_argument("--exposure-ms", type=positive, default=EXPOSURE_MS, metavar="MS", help="oak: default 2")
    parser.add_argument("--seconds", type=positive, metavar="S", help="oak: stop after so long")


def printed_mm(word: str) -> float:
    """A tag's printed side from the command line, mm."""
    side_mm = positive(word)
    if not SIDE_MM[0] <= side_mm <= SIDE_MM[1]:
        raise argparse.ArgumentTypeError(f"{word!r} mm is no tag's side: {SIDE_MM[0]:g} to {SIDE_MM[1]:g}")
    return side_mm


def run(args: argparse.Namespace) -> int:
    """Watch until the frames end or somebody stops it; then say what the tags contradict.

    Raises TagError where a size cannot be; what was recorded is there all the same.
    """
    from drivers.camera.graph import watch
    from drivers.camera.sources import OAK, Lens, Oak
    from holdfast.onset import doubt
    from holdfast.run import say, stop_signals

    source: Source
    if args.camera == OAK:
        if args.tag_mm is None:
            raise UsageError(
                "--tag-mm is missing", cause="millimetres come from the printed side",
                next_step="measure a tag's black square with a calliper and give --tag-mm 9.96",
            )  # fmt: skip
        source = Oak(Lens(args.fps, args.exposure_ms, args.tag_mm, "monotonic", args.apart_mm), args.seconds)
    else:
        source = stored(Path(args.camera), say)
        if args.apart_mm is not None:
            source.lens = replace(source.lens, apart_mm=args.apart_mm)
    with stop_signals() as stopped:
        watched = watch(source, args.out, say=say, stopped=stopped)
    print(f"{watched.frames} frames with tags read, {watched.in_video} in the video, {watched.lost} lost between them")
    print(f"{args.out}; next: holdfast onset {args.out}")
    wrong = doubt(args.out)
    if isinstance(wrong, TagError):
        raise wrong
    if wrong is not None:
        say(f"warning: {wrong}")
    return 0


def stored(path: Path, say: Callable[[str], None]) -> Source:
    """Frames on disk or a recorded folder as a source. Raises a DataError or LibraryMissing."""
    from drivers.camera.library import load_depthai
    from drivers.camera.recording import read_recorded
    from drivers.camera.sources import read_frames

    return read_recorded(path, load_depthai(say)) if path.is_dir() else read_frames(path)
