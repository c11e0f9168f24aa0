"""Jobs for other processes, in a module that loads nothing: each process imports it anew."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from threading import Event

HELD = Event()
"""Ends the held jobs of this process."""


def square(number: int) -> tuple[int, int]:
    """A number's square, and the process that computed it."""
    return number * number, os.getpid()


def dies_at_gate(gate: Path) -> None:
    """Kills its own process once something opens the other end of a named pipe."""
    gate.read_bytes()
    os.kill(os.getpid(), signal.SIGKILL)


def held(pipe: Path) -> None:
    """Writes a byte once it runs, and has the pipe open until HELD is set or its process ends."""
    with pipe.open("wb", buffering=0) as begun:
        begun.write(b".")
        HELD.wait()
