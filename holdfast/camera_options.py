"""The camera's options, declared once for every verb that films, and stored frames as a source."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edge_runtime.command import positive

if TYPE_CHECKING:
    from drivers.camera.sources import Source

FPS, EXPOSURE_MS = 60.0, 2.0
SIDE_MM = (1.0, 200.0)
"""No tag beside a hand is smaller or larger: what is, is no millimetre."""


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """--tag-mm, --fps and --exposure-ms, which an OAK camera needs."""
    parser.add_argument(
        "--tag-mm",
        type=printed_mm,
        metavar="MM",
        help="oak: the printed side of the tags, measured",
    )
    parser.add_argument(
        "--fps", type=positive, default=FPS, metavar="HZ", help=f"oak: default {FPS:g}"
    )
    parser.add_argument(
        "--exposure-ms",
        type=positive,
        default=EXPOSURE_MS,
        metavar="MS",
        help=f"oak: default {EXPOSURE_MS:g}",
    )


def printed_mm(word: str) -> float:
    """A tag's printed side from the command line, mm."""
    side_mm = positive(word)
    if not SIDE_MM[0] <= side_mm <= SIDE_MM[1]:
        raise argparse.ArgumentTypeError(
            f"{word!r} mm is no tag's side: {SIDE_MM[0]:g} to {SIDE_MM[1]:g}"
        )
    return side_mm


def stored(path: Path, say: Callable[[str], None]) -> Source:
    """Frames on disk or a recorded folder as a source. Raises a DataError or LibraryMissing."""
    from drivers.camera.library import load_depthai
    from drivers.camera.recording import read_recorded
    from drivers.camera.sources import read_frames

    return read_recorded(path, load_depthai(say)) if path.is_dir() else read_frames(path)
