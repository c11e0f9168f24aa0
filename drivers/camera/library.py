"""depthai, imported late and told first to send nothing: the one place that imports it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from edge_runtime.errors import CameraUnavailable, LibraryMissing

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
"""What depthai is told unless the user has said otherwise: send nothing, save no dumps, ask no
network, search 1.5 s and not ten, log errors only, leave the signals alone (its handler makes a
file-size limit kill the process), and write video in one thread (the others wait for each frame
busily, thousands of turns a second, a sixth of a core)."""
ABSENT = (
    "not plugged in, no USB here, or a cable for power only",
    "lsusb -d 03e7: shows it; another cable or port",
)
DENIED = (
    "no udev rule for the vendor 03e7",
    "add the rule of docs/camera.md, then plug it in anew",
)


def load_depthai(say: Callable[[str], None]) -> Any:
    """depthai, after QUIET has been put into the environment, which is said in one line once.
    Raises LibraryMissing.

    It reads its environment once, when it is imported: setting it later is too late.
    """
    if there := sys.modules.get("depthai"):
        return there
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    differs = [
        f"{name}={os.environ[name]}" for name, value in QUIET.items() if os.environ[name] != value
    ]
    told = f"; left as you set it: {', '.join(differs)}" if differs else ""
    say(
        f"camera: depthai sends usage data unless told not to; told not to, and to look for cameras on USB only{told}"
    )
    try:
        return import_module("depthai")
    except ImportError as error:
        raise LibraryMissing(
            f"depthai does not load ({error})",
            where="camera",
            cause="it comes with the extra `camera` only",
            next_step="pip install 'holdfast[camera]'",
        ) from None


@contextmanager
def opening() -> Iterator[None]:
    """Whatever depthai raises on the way to a camera, as CameraUnavailable."""
    try:
        yield
    except RuntimeError as error:
        text = str(error)
        cause, step = DENIED if "permission" in text.lower() else ABSENT
        raise CameraUnavailable(
            f"no camera ({text})", where="oak", cause=cause, next_step=step
        ) from None
