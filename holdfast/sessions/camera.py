"""Which camera films, and how: the options --camera, --tag-mm, --fps and --exposure-ms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.errors import UsageError
from holdfast.drivers.camera.library import load_depthai
from holdfast.drivers.camera.recording import read_recorded
from holdfast.drivers.camera.sources import OAK, FrameSource, read_frames

FPS, EXPOSURE_MS = 60.0, 2.0
"""Of an OAK camera, where nothing else is given."""


@dataclass(frozen=True)
class CameraOptions:
    """A camera as the user named it. Only an OAK on USB uses the other options.

    camera: oak, scene, or a file; None films nothing. tag_mm: measured side of the printed tags.
    """

    camera: str | None
    tag_mm: float | None = None
    fps: float | None = None
    exposure_ms: float | None = None

    def require_complete(self, seconds: float | None = None) -> None:
        """Raise UsageError for an OAK without the side of its tags, and for ignored options.

        seconds: a further option that only an OAK uses.
        """
        if self.camera == OAK:
            if self.tag_mm is None:
                raise UsageError(
                    "--tag-mm is missing",
                    cause="millimetres are derived from the printed side",
                    next_step="measure a tag's black square with a calliper and give --tag-mm 9.96",
                )
            return
        ignored = {
            "--tag-mm": self.tag_mm,
            "--fps": self.fps,
            "--exposure-ms": self.exposure_ms,
            "--seconds": seconds,
        }
        given = [option for option, value in ignored.items() if value is not None]
        if given:
            corrects = "; holdfast onset --tag-mm corrects the side"
            raise UsageError(
                f"{', '.join(given)} would be ignored",
                cause=f"only --camera {OAK} uses it; other frames bring their own",
                next_step=f"omit it{corrects if '--tag-mm' in given else ''}",
            )

    def shooting(self) -> dict[str, Any]:
        """Frames a second, exposure and side of an OAK camera."""
        return {
            "fps": self.fps or FPS,
            "exposure_ms": self.exposure_ms or EXPOSURE_MS,
            "tag_mm": self.tag_mm,
        }


def stored_frames(path: Path, report: Callable[[str], None]) -> FrameSource:
    """Frames on disk or a recorded folder as a source. Raises a DataError or LibraryMissing."""
    if path.is_dir():
        return read_recorded(path, load_depthai(report))
    return read_frames(path)
