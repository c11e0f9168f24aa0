"""A small process that writes the last line where the run dies without writing it."""

from __future__ import annotations

import mmap
import os
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from holdfast.core.errors import OutputError
from holdfast.core.line_key import LinkKey
from holdfast.live.guardian_process import (
    FRESH,
    GOODBYE,
    MEMORY_BYTES,
    READY,
    RELEASE,
    SEQUENCE_BYTES,
)

SCRIPT = Path(__file__).with_name("guardian_process.py")
START_S = 30.0
"""A guardian that does not answer within this time after its start is an error."""
END_S = 0.2
"""How long the parent waits for its guardian to end."""


class Guardian:
    """The guardian's process. pid: its process id.

    text: the last line, with %(sequence)d and %(t_ns)d where numbers belong. key: of the link, None
    where lines are not sealed. Raises OutputError where it cannot be started.
    """

    def __init__(self, text: str, key: LinkKey | None = None) -> None:
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # shared memory, so that a new number costs no system call at any sample
        memory_fd = os.memfd_create("holdfast sequence")
        os.ftruncate(memory_fd, MEMORY_BYTES)
        self._memory = mmap.mmap(memory_fd, MEMORY_BYTES)
        self._sequence = memoryview(self._memory)[:SEQUENCE_BYTES].cast("q")
        # no line was sent yet
        self._sequence[0] = -1
        link = []
        if key is not None:
            # in memory, because other users can read a command line
            self._memory[SEQUENCE_BYTES : SEQUENCE_BYTES + len(key.key)] = key.key
            link = [key.link]
        numbers = [theirs.fileno(), memory_fd]
        try:
            self._process = subprocess.Popen(
                # isolated and without site packages: it starts fast, and imports nothing of the
                # user
                [
                    sys.executable,
                    "-I",
                    "-S",
                    str(SCRIPT),
                    *map(str, numbers),
                    text,
                    *link,
                ],
                pass_fds=numbers,
                # Ctrl-C in the terminal must not end the guardian before the run
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            # only the guardian holds this end now, so its end is seen at once while it starts
            theirs.close()
            self._wait_until_ready()
        except OSError as error:
            raise OutputError(
                f"no guardian process ({error.strerror or error})"
            ) from None
        finally:
            theirs.close()
            os.close(memory_fd)

        self.pid = self._process.pid

    def _wait_until_ready(self) -> None:
        self._control.settimeout(START_S)
        if self._control.recv(16) != READY:
            raise OSError("it ended at once")
        # from now on the loop uses it, and never waits
        self._control.setblocking(False)

    def hold(self, handle: int) -> None:
        """Give it the descriptor to write to, instead of the one before."""
        with suppress(OSError):
            socket.send_fds(self._control, [FRESH], [handle])

    def release(self) -> None:
        """Let it close its descriptor."""
        with suppress(OSError):
            self._control.send(RELEASE)

    def note(self, sequence: int) -> None:
        """The newest sequence; costs no system call."""
        self._sequence[0] = sequence

    def lives(self) -> bool:
        """Whether its process still runs."""
        return self._process.poll() is None

    def end(self, *, written: bool) -> None:
        """End it. written: the last line was written; else the guardian writes it."""
        # without a goodbye the guardian sees the link close, and writes the last line
        if written:
            with suppress(OSError):
                self._control.send(GOODBYE)
        self._control.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
