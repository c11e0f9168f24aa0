"""The camera's graph in a process of its own, beside the recorder, on the same monotonic clock.

    python -m holdfast.recorder.filming '{"camera": "oak", "out": "trial_1", "fps": 60, ..}'

It ends when its standard input does, so that it outlives no recorder, however that one ended. A
scene is then watched up to that moment, whatever the machine has to do beside; a camera is just
stopped. What may be wrong with it stands in camera.json, and on stderr as ever.
"""

from __future__ import annotations

import json
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from drivers.camera.graph import watch
from drivers.camera.sources import OAK, Frame, Lens, Oak, Source, Stored
from drivers.virtual.clock import Clock, WallClock
from edge_runtime.command import finish
from edge_runtime.errors import UsageError
from holdfast.camera_options import stored
from holdfast.live_sources import scene_of
from holdfast.messages import say

SCENE = "scene"
LONGEST_S = 36_000.0
POLL_NS = 10_000_000
NICE = 5
"""The hand goes first: it loses what it does not read in time, the camera's queues wait."""


def main(argv: Sequence[str]) -> int:
    """Film until a signal, or until the frames end."""
    told = json.loads(argv[0])
    os.nice(NICE)
    if told["camera"] == OAK:
        watch(oak(told), Path(told["out"]), say=say, stopped=asked)
    elif told["camera"] == SCENE:
        watch(
            scene(told["source"], told["began_ns"], WallClock(), asked), Path(told["out"]), say=say
        )
    else:
        watch(stored(Path(told["camera"]), say), Path(told["out"]), say=say)
    return 0


def asked() -> bool:
    """Whether whoever started it wants it to end, or is gone."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


def oak(told: dict[str, Any]) -> Oak:
    """A camera on USB as the recorder was told."""
    return Oak(Lens(told["fps"], told["exposure_ms"], told["tag_mm"], clock="monotonic"))


def scene(url: str, began_ns: int, clock: Clock, asked: Callable[[], bool]) -> Source:
    """The scene of a virtual hand, filmed as it goes by; began_ns: by the clock. Raises
    UsageError."""
    camera = camera_of(url)
    found = scene_of(url)
    assert found is not None
    made, told = found
    shoot = made.shooting(told, camera)
    lens = Lens(camera.fps, camera.exposure_ms, camera.tag_mm, clock="monotonic")
    return Stored(f"{SCENE} {url}", lens, _live(shoot, camera.fps, began_ns, clock, asked))


def camera_of(url: str) -> Any:
    """The camera of the scene behind a source. Raises UsageError where there is none."""
    found = scene_of(url) if url.startswith("virtual://") else None
    if found is None or found[0].camera is None:
        raise UsageError(
            f"--camera {SCENE} films no {url!r}",
            cause="no virtual hand in a scene, or its card has no [camera]",
            next_step="virtual://ft232h?scene=CARD with [camera] and [effects.camera_frames] on the card",
        )
    return found[0].camera


def _live(
    shoot: Callable[[float], Any],
    fps: float,
    began_ns: int,
    clock: Clock,
    asked: Callable[[], bool],
) -> Iterator[Frame]:
    """Frames from now on, none before its time, until it is asked to end; the last one is of that
    moment."""
    first = max(1, int((clock.now_ns() - began_ns) * 1e-9 * fps))
    until_ns = began_ns + round(1e9 * LONGEST_S)
    for k in range(first, first + round(LONGEST_S * fps)):
        end_s = k / fps
        end_ns = began_ns + round(1e9 * end_s)
        while (now_ns := clock.now_ns()) < end_ns and not asked():
            clock.spend(min(POLL_NS, end_ns - now_ns))
        until_ns = min(until_ns, now_ns) if asked() else until_ns
        if end_ns > until_ns:
            return
        yield Frame(k - first, 1e-9 * began_ns + end_s, shoot(end_s))


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
