"""Keys of the operator, one press at a time.

A terminal in cbreak mode (also over SSH), pipe or file.
"""

from __future__ import annotations

import os
import select
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress

KEYS = {
    " ": "begin",
    "\n": "begin",
    "k": "keep",
    "r": "redo",
    "q": "stop",
    "l": "load_onset",
    "e": "contact_lost",
}
ESCAPE = b"\x1b"
HELP_READY = "space begins, r does the last one again, q stops"
HELP_TRIAL = "l load comes on, e released, k keep and next, r redo, q keep and stop"


class Keys:
    """Keys pressed on a file descriptor; none after its end. handle None: no key can be pressed."""

    def __init__(self, handle: int | None) -> None:
        self._handle = handle
        self._next = b""
        self.last = ""
        """The last letter that `pressed` met, whatever it means."""

    @property
    def closed(self) -> bool:
        """Whether no key can be pressed any more."""
        return self._handle is None and not self._next

    def ended(self) -> bool:
        """`closed` after a look, without waiting, whether the input is at its end; loses no key."""
        self._next = self._next or self._read(0.0)
        return self.closed

    def pressed(self, wait_s: float = 0.0) -> str:
        """The next known key by its name in KEYS, or ""; waits no longer than wait_s."""
        letter = self.letter(wait_s)
        self.last = letter or self.last
        return KEYS.get(letter, "")

    def letter(self, wait_s: float = 0.0) -> str:
        """The next key as a small letter, or ""; an arrow key, which ends in a letter, is none."""
        byte = self.byte(wait_s)
        if byte == ESCAPE:
            # What came with it, such as the rest of an arrow key.
            while self.byte():
                pass
            return ""
        return byte.decode("ascii", "replace").lower()

    def byte(self, wait_s: float = 0.0) -> bytes:
        """The next byte that was typed, or b""; waits no longer than wait_s."""
        byte = self._next or self._read(wait_s)
        self._next = b""
        return byte

    def _read(self, wait_s: float) -> bytes:
        """The next byte; empty if none came in that time, or at the end of the input."""
        if self._handle is None or not select.select([self._handle], [], [], wait_s)[0]:
            return b""
        try:
            byte = os.read(self._handle, 1)
        except OSError:  # the terminal is gone
            byte = b""
        # An empty read is the end of the input, for good.
        if not byte:
            self._handle = None
        return byte


@contextmanager
def listening(handle: int) -> Iterator[Keys]:
    """Keys of a descriptor.

    A terminal reports single presses within the block, and is then restored. Keys that were pressed
    before the block count. TCSANOW: the others wait for output that a stopped terminal never takes.

    If the terminal belongs to another program (we run in the background), nothing is read from it.
    """
    if not os.isatty(handle):
        yield Keys(handle)
        return
    # A read in the background would stop the whole program (SIGTTIN).
    if os.tcgetpgrp(handle) != os.getpgrp():
        yield Keys(None)
        return

    before = termios.tcgetattr(handle)
    try:
        tty.setcbreak(handle, termios.TCSANOW)
        yield Keys(handle)
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(handle, termios.TCSANOW, before)
