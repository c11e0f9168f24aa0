"""Tracks of two tags that were never filmed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from drawn_frames import (
    FPS,
)

from holdfast.drivers.camera.recording import TagFile, Tracks, read_tracks, write_about
from holdfast.drivers.camera.sources import LENS

SIDES = [-20.0, -20.0, 20.0, -20.0, 20.0, 20.0, -20.0, 20.0]


def hand_made(folder: Path, *, at_s: float, slides_at_s: float | None) -> Tracks:
    """Tracks on the machine's clock, with an object that slides 300 mm/s^2; no video."""
    t_s = np.arange(0, 90) / FPS
    with TagFile(folder) as file:
        for k, now_s in enumerate(t_s):
            down_px = (
                0.0
                if slides_at_s is None
                else 600.0 * max(0.0, now_s - slides_at_s) ** 2
            )
            places = {0: (180.0, 100.0 + down_px), 1: (100.0, 100.0)}
            square = {
                tag: [x + dx for x, dx in zip(at * 4, SIDES, strict=True)]
                for tag, at in places.items()
            }
            file.write(k, at_s + float(now_s), square)
    about: dict[str, object] = dict(zip(LENS, (FPS, 2.0, 10.0), strict=True))
    write_about(folder, about | {"clock": "monotonic", "void": None})
    return read_tracks(folder)
