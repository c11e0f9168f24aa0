"""The only import of depthai: late, and with its telemetry switched off first."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from holdfast.core.errors import CameraUnavailable, LibraryMissing

QUIET = {
    "DEPTHAI_TELEMETRY": "0",
    "DEPTHAI_CRASHDUMP": "0",
    "DEPTHAI_DISABLE_CRASHDUMP_COLLECTION": "1",
    "DEPTHAI_ZOO_INTERNET_CHECK": "0",
    "DEPTHAI_PROTOCOL": "usb",
    "DEPTHAI_SEARCH_TIMEOUT": "1500",
    "DEPTHAI_LEVEL": "error",
    "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0",
    "OPENCV_FOR_THREADS_NUM": "1",
}
"""Environment of depthai unless the user has set it: no telemetry, no dumps, no network.

It also searches 1.5 s instead of ten, logs errors only, and installs no signal handler (with it, a
file-size limit kills the process). Video is written by one thread, because further threads wait for
each frame busily, with thousands of wake-ups a second and a sixth of a core.
"""
ABSENT = (
    "not plugged in, no USB here, or a cable for power only",
    "lsusb -d 03e7: lists the camera if it is there; try another cable or port",
)
DENIED = (
    "no udev rule for the vendor 03e7",
    "add the rule in docs/camera.md, then unplug the camera and plug it in",
)


def load_depthai(say: Callable[[str], None]) -> Any:
    """Import depthai after putting QUIET into the environment; say so once. Raises LibraryMissing.

    depthai reads its environment once, when it is imported; a later change has no effect.
    """
    if there := sys.modules.get("depthai"):
        return there
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    differs = [
        f"{name}={os.environ[name]}"
        for name, value in QUIET.items()
        if os.environ[name] != value
    ]
    kept = f"; your own settings stay: {', '.join(differs)}" if differs else ""
    say(
        f"camera: depthai's usage data are switched off; it looks for cameras on USB only{kept}"
    )
    try:
        return import_module("depthai")
    except ImportError as error:
        raise LibraryMissing(
            f"depthai does not load ({error})",
            where="camera",
            cause="only the extra `camera` installs it",
            next_step="pip install 'holdfast[camera]'",
        ) from None


@contextmanager
def opening() -> Iterator[None]:
    """Turn what depthai raises on the way to a camera into CameraUnavailable."""
    try:
        yield
    except RuntimeError as error:
        text = str(error)
        cause, step = DENIED if "permission" in text.lower() else ABSENT
        raise CameraUnavailable(
            f"no camera ({text})", where="oak", cause=cause, next_step=step
        ) from None
