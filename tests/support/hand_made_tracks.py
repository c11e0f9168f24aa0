"""Tracks of two tags that were never filmed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from drawn_frames import FPS

from holdfast.drivers.camera.recording import (
    CameraFacts,
    Tracks,
    new_tag_file,
    read_tracks,
    write_about,
    write_tags,
)

SIDES = [-20.0, -20.0, 20.0, -20.0, 20.0, 20.0, -20.0, 20.0]


def hand_made(folder: Path, *, at_s: float, slides_at_s: float | None) -> Tracks:
    """Tracks on the machine's clock, with an object that slides 300 mm/s^2; no video."""
    t_s = np.arange(0, 90) / FPS
    with new_tag_file(folder) as file:
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
            write_tags(file, k, at_s + float(now_s), square)
    facts = CameraFacts(fps=FPS, exposure_ms=2.0, tag_mm=10.0, clock="monotonic")
    write_about(folder, facts)
    return read_tracks(folder)
