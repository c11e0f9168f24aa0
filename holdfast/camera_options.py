"""The camera options of every verb that films, and stored frames as a source."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.edge_runtime.command import positive
from holdfast.edge_runtime.errors import UsageError

if TYPE_CHECKING:
    from holdfast.drivers.camera.sources import FrameSource

FPS, EXPOSURE_MS = 60.0, 2.0
OF_OAK = ("tag_mm", "fps", "exposure_ms")
"""What only a camera on USB uses: stored frames and scenes bring their own."""
SIDE_MM = (1.0, 200.0)
"""Plausible sides of a tag; a number outside is probably not in millimetres."""


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """--tag-mm, --fps and --exposure-ms, which an OAK camera needs."""
    option = parser.add_argument
    side = "oak: measured side of the printed tags"
    option("--tag-mm", type=printed_mm, metavar="MM", help=side)
    fps = f"oak: frames a second (default {FPS:g})"
    option("--fps", type=positive, metavar="HZ", help=fps)
    exposure = f"oak: exposure (default {EXPOSURE_MS:g})"
    option("--exposure-ms", type=positive, metavar="MS", help=exposure)


def require_camera_options(args: argparse.Namespace, *more: str) -> None:
    """Raise UsageError for an OAK without the side of its tags, and for options that are ignored.

    more: names of further options that only an OAK uses.
    """
    from holdfast.drivers.camera.sources import OAK

    if args.camera == OAK:
        if args.tag_mm is None:
            raise UsageError(
                "--tag-mm is missing",
                cause="millimetres are derived from the printed side",
                next_step="measure a tag's black square with a calliper and give --tag-mm 9.96",
            )
        return
    given = [name for name in (*OF_OAK, *more) if getattr(args, name) is not None]
    if given:
        words = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        corrects = "; holdfast onset --tag-mm corrects the side" if "tag_mm" in given else ""
        raise UsageError(
            f"{words} would be ignored",
            cause=f"only --camera {OAK} uses it; other frames bring their own",
            next_step=f"omit it{corrects}",
        )


def shooting(args: argparse.Namespace) -> dict[str, float]:
    """Frames a second, exposure and side of an OAK camera."""
    return {
        "fps": args.fps or FPS,
        "exposure_ms": args.exposure_ms or EXPOSURE_MS,
        "tag_mm": args.tag_mm,
    }


def printed_mm(word: str) -> float:
    """A tag's printed side from the command line, mm."""
    side_mm = positive(word)
    if not SIDE_MM[0] <= side_mm <= SIDE_MM[1]:
        allowed = f"{SIDE_MM[0]:g} to {SIDE_MM[1]:g}"
        raise argparse.ArgumentTypeError(f"{word!r} mm is not the side of a tag: {allowed}")
    return side_mm


def stored(path: Path, say: Callable[[str], None]) -> FrameSource:
    """Frames on disk or a recorded folder as a source. Raises a DataError or LibraryMissing."""
    from holdfast.drivers.camera.library import load_depthai
    from holdfast.drivers.camera.recording import read_recorded
    from holdfast.drivers.camera.sources import read_frames

    return read_recorded(path, load_depthai(say)) if path.is_dir() else read_frames(path)
