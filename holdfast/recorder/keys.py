"""Keys of the operator, one press at a time, also over SSH: plain stdin in cbreak mode, a pipe or a
file as well."""

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
HELP_READY = "space begins, r does the last one again, q stops"
HELP_TRIAL = "l load comes on, e released, k keep and next, r redo, q keep and stop"


class Keys:
    """What was pressed on a file descriptor; at its end nothing more comes. None: nobody can press
    anything."""

    def __init__(self, handle: int | None) -> None:
        self._handle = handle

    @property
    def closed(self) -> bool:
        """Whether nobody can press anything any more."""
        return self._handle is None

    def pressed(self, wait_s: float = 0.0) -> str:
        """The next known key by its name in KEYS, or ""; waits no longer than wait_s."""
        if self._handle is None:
            select.select([], [], [], wait_s)
            return ""
        if not select.select([self._handle], [], [], wait_s)[0]:
            return ""
        try:
            byte = os.read(self._handle, 1)
        except OSError:  # a terminal that is gone
            byte = b""
        if not byte:
            self._handle = None
        return KEYS.get(byte.decode("ascii", "replace").lower(), "")


@contextmanager
def listening(handle: int) -> Iterator[Keys]:
    """Keys of a descriptor; a terminal answers single presses meanwhile, and is as before on every
    way out.

    Of a terminal that belongs to another program just now (we run in the background) nothing is
    read.
    """
    if not os.isatty(handle):
        yield Keys(handle)
        return
    if os.tcgetpgrp(handle) != os.getpgrp():
        yield Keys(None)
        return
    before = termios.tcgetattr(handle)
    try:
        tty.setcbreak(handle)
        yield Keys(handle)
    finally:
        with suppress(termios.error):  # a terminal that is gone
            termios.tcsetattr(handle, termios.TCSADRAIN, before)
