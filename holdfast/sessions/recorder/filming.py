"""The camera's graph in a separate process beside the recorder, on the same monotonic clock.

    python -m holdfast.sessions.recorder.filming '{"camera": "oak", "out": "trial_1", ..}'

It ends when its standard input does, so it never outlives the recorder. A scene is then filmed up
to that moment, however busy the machine is; a camera is stopped at once. Errors are written to
camera.json and stderr.
"""

from __future__ import annotations

import json
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from holdfast.cli.command import finish
from holdfast.core.errors import UsageError
from holdfast.core.reading import Json
from holdfast.drivers.camera.graph import watch
from holdfast.drivers.camera.sources import OAK, Frame, FrameSource, Lens, Oak, Stored
from holdfast.drivers.virtual.clock import Clock, WallClock
from holdfast.live.hand_sources import scene_of
from holdfast.live.stopping import say
from holdfast.sessions.camera import stored_frames

SCENE = "scene"
LONGEST_S = 36_000.0
POLL_NS = 10_000_000
NICE = 5
"""The hand has precedence: it loses samples that are read late; the camera's queues can wait."""


def main(argv: Sequence[str]) -> int:
    """Film until a signal, or until the frames end."""
    options = json.loads(argv[0])
    os.nice(NICE)
    out = Path(options["out"])
    if options["camera"] == OAK:
        watch(oak(options), out, say=say, stopped=must_end)
    elif options["camera"] == SCENE:
        source = scene(options["source"], options["began_ns"], WallClock(), must_end)
        watch(source, out, say=say)
    else:
        watch(stored_frames(Path(options["camera"]), say), out, say=say)
    return 0


def must_end() -> bool:
    """Whether the recorder has closed standard input, or has ended."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


def oak(options: Json) -> Oak:
    """A camera on USB with the recorder's options."""
    lens = Lens(
        options["fps"], options["exposure_ms"], options["tag_mm"], clock="monotonic"
    )
    return Oak(lens)


def scene(
    url: str, began_ns: int, clock: Clock, must_end: Callable[[], bool]
) -> FrameSource:
    """The scene of a virtual hand, filmed live; began_ns: its start on the clock.

    Raises UsageError.
    """
    made, trial = _filmed_scene(url)
    camera = made.camera
    shoot = made.shooting(trial, camera)
    lens = Lens(camera.fps, camera.exposure_ms, camera.tag_mm, clock="monotonic")
    return Stored(
        f"{SCENE} {url}", lens, _live(shoot, camera.fps, began_ns, clock, must_end)
    )


def require_camera_in(url: str) -> None:
    """Raise UsageError where a source has no scene with a camera."""
    _filmed_scene(url)


def _filmed_scene(url: str) -> Any:
    """(scene, trial) of a virtual hand whose scene has a camera. Raises UsageError."""
    scene_and_trial = scene_of(url) if url.startswith("virtual://") else None
    if scene_and_trial is None or scene_and_trial[0].camera is None:
        raise UsageError(
            f"--camera {SCENE} cannot film {url!r}",
            cause="no virtual hand in a scene, or its card has no [camera]",
            next_step="virtual://ft232h?scene=CARD, "
            "with [camera] and [effects.camera_frames] on the card",
        )
    return scene_and_trial


def _live(
    shoot: Callable[[float], Any],
    fps: float,
    began_ns: int,
    clock: Clock,
    must_end: Callable[[], bool],
) -> Iterator[Frame]:
    """Frames from now on, none before its time, until it must end; the last is of that moment."""
    first = max(1, int((clock.now_ns() - began_ns) * 1e-9 * fps))
    until_ns = began_ns + round(1e9 * LONGEST_S)
    for k in range(first, first + round(LONGEST_S * fps)):
        end_s = k / fps
        end_ns = began_ns + round(1e9 * end_s)
        while (now_ns := clock.now_ns()) < end_ns and not must_end():
            clock.spend(min(POLL_NS, end_ns - now_ns))
        until_ns = min(until_ns, now_ns) if must_end() else until_ns
        if end_ns > until_ns:
            return
        yield Frame(k - first, 1e-9 * began_ns + end_s, shoot(end_s))


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
