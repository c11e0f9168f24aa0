"""Frames of tags drawn in a known motion, and depthai outside the process of the tests: what
crashes it fails one test."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_frames import GREY, Camera, Frames
from camera_process import CameraProcess

from holdfast.core.contract import FloatArray
from holdfast.drivers.camera.graph import QUIET

ROOT = Path(__file__).resolve().parents[2]
SIZE = {"width_px": 320.0, "height_px": 240.0}
FPS, N_FRAMES = 60.0, 90
COVERED, TWICE = range(60, 66), range(70, 72)


def camera(**changed: float) -> Camera:
    return Camera(**SIZE | changed)


def settings(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """The environment; what the machine says about depthai is left out."""
    plain = {
        key: value
        for key, value in os.environ.items()
        if key not in QUIET and not key.startswith("DEPTHAI_")
    }
    return plain | dict(environment or {})


SHARED = CameraProcess(settings())


@pytest.fixture(scope="session", autouse=True)
def _shared_process_ends() -> Iterator[None]:
    yield
    SHARED.end()


def command(*words: object) -> subprocess.CompletedProcess[str]:
    """The command line in the process that has loaded depthai already."""
    return SHARED.run(*map(str, words))


def fresh_command(
    *words: object, **environment: str
) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own, which loads depthai in this environment."""
    return process("-m", "holdfast", *map(str, words), environment=environment)


def process(
    *words: str,
    file_limit: int | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Python in a process of its own."""

    def limit() -> None:
        if file_limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))

    return subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env=settings(environment),
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
    )


def program(text: str, *words: object) -> dict[str, Any]:
    """What a program prints last as one line of JSON; depthai is loaded already."""
    return _json(SHARED.run("-c", PRELUDE + text, *map(str, words)))


def _json(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    assert done.returncode == 0, done.stderr
    # a thread of depthai may write a line of its own afterwards: "[date] [error] .."
    found = [line for line in done.stdout.splitlines() if line.startswith("{")]
    return dict(json.loads(found[-1]))


PRELUDE = """
import json, os, signal, sys
from pathlib import Path
from typing import Any
import numpy as np
from holdfast.drivers.camera.graph import StoredFrames, frames_of_video, load_depthai, watch
from holdfast.drivers.camera.recording import Frame, Lens, read_about, read_frames, read_tracks
from holdfast.core.errors import DeviceLost, HoldfastError
"""


def motion_m(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[T, 3] of object in the hand and of the hand: it sways, and lets the object slide from 0.5 s
    on."""
    thing, hand = np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3))
    thing[:, 2] = -0.015 * np.maximum(t_s - 0.5, 0.0) ** 2
    hand[:, 0], hand[:, 2] = 2e-3 * np.sin(5.0 * t_s), 1e-3 * np.sin(3.0 * t_s)
    return thing, hand


def write_frames(
    path: Path, stamps_s: FloatArray, frames: Frames, **changed: float
) -> Path:
    numbers: dict[str, Any] = {"fps": FPS, "exposure_ms": 2.0, "tag_mm": 10.0} | changed
    np.savez(path, frames=frames, time_s=stamps_s, **numbers)
    return path


@pytest.fixture(scope="session")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray, Frames]:
    """Frames of a known motion; the hand's tag is covered for a while, and the object's seen twice
    for a while."""
    t_s = np.arange(N_FRAMES + 1) / FPS
    stamps_s, frames = camera().film(t_s, *motion_m(t_s))
    for k in COVERED:
        frames[k, :, 90:150] = GREY
    for k in TWICE:
        frames[k, 10:80, 10:80] = frames[k, 113:183, 165:235]
    return (
        write_frames(
            tmp_path_factory.mktemp("drawn") / "known.frames.npz", stamps_s, frames
        ),
        stamps_s,
        frames,
    )


@pytest.fixture(scope="session")
def recorded(
    drawn: tuple[Path, FloatArray, Frames], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The folder that watching them leaves. Read only."""
    out = tmp_path_factory.mktemp("recorded") / "trial"
    done = command("watch", "--camera", drawn[0], "--out", out)
    assert done.returncode == 0, done.stderr
    assert (
        f"{N_FRAMES} frames with tags read, {N_FRAMES} in the video, 0 lost"
        in done.stdout
    )
    return out


def two_sizes(path: Path, n: int = 30) -> Path:
    """Frames of the object's tag at 10 mm and the hand's at 8, both declared as 10."""
    stamps_s = np.arange(1, n + 1) / FPS
    away = np.array([1e4, 0.0])
    both = (
        camera().draw(np.zeros(2), away)
        + camera(tag_mm=8.0).draw(away, np.zeros(2))
        - GREY
    )
    frames = np.repeat(np.rint(both).astype(np.uint8)[None], len(stamps_s), axis=0)
    return write_frames(path, stamps_s, frames)
