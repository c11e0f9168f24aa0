"""Progress of long work on stderr: a line for each stage, and on a terminal the share that is done.

A function that takes long has two parameters: `say`, which receives the name of each stage as it
begins, and `part`, which receives the share of the stage that is done.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from holdfast.core.errors import visible

Say = Callable[[str], None]
Part = Callable[[float], None]
"""Takes which share of the stage under way is done, 0 to 1."""
TO_LINE_START = "\r\x1b[K"
"""Removes the share, so that a line of another stage stands alone."""


class Stages:
    """Call it with the stage that begins; `part` takes the share of it that is done."""

    def __init__(self) -> None:
        self._started_s = self._began_s = time.perf_counter()

    def __call__(self, text: str) -> None:
        """The stage under way has ended, and this one begins."""
        self._began_s = time.perf_counter()
        elapsed_s = self._began_s - self._started_s
        sys.stderr.write(f"{elapsed_s:6.0f} s  {visible(text)}\n")

    def part(self, share: float) -> None:
        """So much of the stage under way is done, 0 to 1."""
        if not sys.stderr.isatty():
            return
        # a share of nothing would say that the rest takes for ever
        share = max(share, 0.01)
        left_s = (time.perf_counter() - self._began_s) * (1.0 - share) / share
        shown = f"{share:8.0%}, {left_s:.0f} s left" if share < 1.0 else ""
        sys.stderr.write(f"{TO_LINE_START}{shown}")
        sys.stderr.flush()


def ignored(message: object) -> None:
    """A Say or a Part that shows nothing."""
