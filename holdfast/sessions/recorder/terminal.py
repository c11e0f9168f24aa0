"""The operator's terminal during a session: keys, one press at a time, and the status line.

The line has time, lost samples, and the force on each finger. It is redrawn in place a few times a
second. Nothing waits for it: a terminal that blocks misses updates. Keys come from a terminal in
cbreak mode (also over SSH), a pipe or a file.
"""

from __future__ import annotations

import array
import fcntl
import os
import re
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from holdfast.core.errors import visible_lines
from holdfast.core.lines import stream_sink
from holdfast.core.source import SourceReading
from holdfast.live.running import RunClock

if TYPE_CHECKING:
    from holdfast.sessions.recorder.trial import TrialRecorder

KEYS = {
    " ": "begin",
    "\n": "begin",
    "k": "keep",
    "r": "redo",
    "q": "stop",
    "l": "load_onset",
    "e": "contact_lost",
}
URGENT = "aq"
"""A study's adverse event, and stop: they count even where they are typed before the question."""
ESCAPE = b"\x1b"
PASTE, PASTE_END = b"\x1b[200~", b"\x1b[201~"
"""What a terminal puts around pasted text, where it is asked to."""
ASK_FOR_PASTE_MARKS, NO_PASTE_MARKS = b"\x1b[?2004h", b"\x1b[?2004l"
SEQUENCE = re.compile(
    rb"\x1b+(\[\[.|\[(?!\[)[ -?]*[^ -?]|O[ -?]*[^ -?]|"
    rb"[]PX^_][^\x07\x1b]*(\x07|\x1b\\)|[^]\x1b[OPX^_])",
    re.DOTALL,
)
"""A whole key of several bytes: CSI (also as the Linux console sends F1), SS3, a terminal's answer,
or a key with Alt."""
ESCAPE_S = 0.1
"""Nothing for so long after an Escape: it was the key of that name."""
SEQUENCE_S = 1.0
"""Nothing for so long within a sequence or a paste: the rest is lost."""
AT_ONCE_S = 0.02
"""Letters that follow each other faster were not typed by hand."""
TEXT = "text"
"""In place of a letter, where a text was pasted."""
TEXT_IS_NO_KEY = "that was several letters at once, and no key; press one key"
READ_BYTES = 4096
LOCAL_FLAGS = 3
"""Of the list that termios gives."""
HELP_READY = "space begins, r does the last one again, q stops"
HELP_TRIAL = "l load comes on, e released, k keep and next, r redo, q keep and stop"
REDRAW_NS = 250_000_000
"""Four times a second: more cannot be read, and costs time between samples."""
COLUMNS = 80
"""Where a terminal does not know its width."""
OVER_THE_LINE_ABOVE = "\x1b[A\r\x1b[2K"
"""Cursor up, first column, erase the line: the next output replaces the line above."""


class Keys:
    """Keys pressed on a file descriptor; none after its end. handle None: no key can be pressed.

    terminal: the descriptor's, where a person types. Then what was typed too early is dropped, and
    letters that come together are a paste; in a pipe or a file every byte is a key.
    """

    def __init__(
        self, handle: int | None, terminal: CbreakTerminal | None = None
    ) -> None:
        self._handle = handle
        self._terminal = terminal
        self._ahead = bytearray()
        """What was read and is not taken yet."""
        self._sequence = bytearray()
        """The beginning of a key of several bytes."""
        self._heard_s = 0.0
        self._kept = ""
        """A key of URGENT that was typed too early."""
        self.last = ""
        """The last letter that `pressed` met, whatever it means."""

    @property
    def closed(self) -> bool:
        """Whether no key can be pressed any more."""
        return self._handle is None and not self._ahead

    def ended(self) -> bool:
        """`closed` after a look, without waiting, whether the input is at its end; loses no key."""
        if not self._ahead:
            self._read(0.0)
        return self.closed

    def pressed(self, wait_s: float = 0.0) -> str:
        """The next known key by its name in KEYS, or ""; waits no longer than wait_s."""
        letter = self.letter(wait_s)
        self.last = letter or self.last
        return KEYS.get(letter, "")

    def letter(self, wait_s: float = 0.0) -> str:
        """The next key as a small letter, or ""; a key of several bytes and a paste are none."""
        if self._kept:
            letter, self._kept = self._kept, ""
            return letter
        return _letter(self.key(wait_s))

    def choice(self, known: Container[str], wait_s: float) -> str:
        """The next letter that a person typed, "", or TEXT.

        Letters that come at once (over a slow link) are one key: the first of URGENT, else the
        first of all. Where one of them is no known key they were pasted: TEXT.
        """
        if self._kept:
            return self.letter()
        keys = [self.key(wait_s)]
        while keys[-1] and (key := self.following()):
            keys.append(key)
        if any(pasted(key) for key in keys):
            return TEXT
        letters = "".join(map(_letter, keys))
        if len(letters) > 1 and not all(letter in known for letter in letters):
            return TEXT
        return _urgent(letters) or letters[:1]

    def drop(self) -> None:
        """Forget what was typed before a question; a letter of URGENT is the next key."""
        self._kept = self._kept or _urgent(self.forgotten())

    def following(self) -> bytes:
        """The next key, if it comes faster than a person types; b"" where no person does."""
        return b"" if self._terminal is None else self.key(AT_ONCE_S)

    def forgotten(self) -> str:
        """Forget what was typed until now; returns its letters. Nothing where no person types."""
        letters = ""
        while self._terminal is not None and (key := self.key()):
            letters += _letter(key)
        return letters

    def key(self, wait_s: float = 0.0) -> bytes:
        """The next key, or b"": a byte, a whole escape sequence, or a paste with its marks.

        Waits no longer than wait_s. A sequence that has only begun waits for a later call.
        """
        byte = self.byte(wait_s)
        while byte:
            if byte != ESCAPE and not self._sequence:
                return byte
            self._sequence += byte
            self._heard_s = time.monotonic()
            if self._is_whole():
                return self._whole()
            byte = self.byte()
        # Alone, or as often as it was pressed.
        is_escape = not self._sequence.strip(ESCAPE)
        silent_s = time.monotonic() - self._heard_s
        if self.closed or silent_s >= (ESCAPE_S if is_escape else SEQUENCE_S):
            whole = self._whole()
            return whole[:1] if is_escape else whole
        return b""

    def _is_whole(self) -> bool:
        if self._sequence.startswith(PASTE):
            return self._sequence.endswith(PASTE_END)
        return (
            SEQUENCE.fullmatch(self._sequence) is not None and self._sequence != PASTE
        )

    def _whole(self) -> bytes:
        whole = bytes(self._sequence)
        self._sequence.clear()
        return whole

    def byte(self, wait_s: float = 0.0) -> bytes:
        """The next byte that was typed, or b""; waits no longer than wait_s."""
        if not self._ahead:
            self._read(wait_s)
        byte = bytes(self._ahead[:1])
        del self._ahead[:1]
        return byte

    def _read(self, wait_s: float) -> None:
        """Read ahead; nothing if none came in that time, or at the end of the input."""
        is_ours = self._terminal is None or self._terminal.ready()
        handles = [self._handle] if is_ours and self._handle is not None else []
        # Without a descriptor there is nothing to wait for; in the background there may be later.
        wait_s = 0.0 if self._handle is None else wait_s
        if not select.select(handles, [], [], wait_s)[0]:
            return
        # Looked at again: Ctrl-Z and `bg` may have come while it waited, and a read in the
        # background stops the whole program (SIGTTIN).
        if self._terminal is not None and not self._terminal.has_keys():
            return
        try:
            # Of a pipe no byte more than is taken: the rest is for the next program.
            typed = os.read(handles[0], 1 if self._terminal is None else READ_BYTES)
        except OSError:  # the terminal is gone
            typed = b""
        # An empty read is the end of the input, for good.
        if not typed:
            self._handle = None
        self._ahead += typed


def _letter(key: bytes) -> str:
    """A key as a small letter; "" for one of several bytes, and for Escape."""
    is_letter = len(key) == 1 and key != ESCAPE
    return key.decode("ascii", "replace").lower() if is_letter else ""


def _urgent(letters: str) -> str:
    """The first letter of URGENT, or ""."""
    return next((letter for letter in letters if letter in URGENT), "")


def pasted(key: bytes) -> bytes:
    """The text of a key that is a paste, on one line; b"" for any other key."""
    if not key.startswith(PASTE):
        return b""
    text = key.removeprefix(PASTE).removesuffix(PASTE_END)
    # Control characters would move the cursor of the reader.
    return b" ".join(re.sub(rb"[\x00-\x1f\x7f]", b" ", text).split())


class CbreakTerminal:
    """A terminal that reports single presses while this program is in front of it.

    The mode is looked at before each read: a shell sets its own after Ctrl-Z, and not all set ours
    again with `fg`. TCSANOW: the others wait for output that a stopped terminal never takes.
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._before: list[Any] | None = None
        self._is_set = False

    def is_in_background(self) -> bool:
        """Whether the terminal belongs to another program of its session."""
        try:
            return os.tcgetpgrp(self._handle) != os.getpgrp()
        # It is no session's terminal (setsid), or it is gone: nothing stops a read from it.
        except OSError:
            return False

    def ready(self) -> bool:
        """Set the mode where it is not; returns whether keys may be read."""
        if self.is_in_background():
            self._is_set = False
            return False
        with suppress(termios.error):  # the terminal is gone
            mode = termios.tcgetattr(self._handle)
            is_by_line = bool(mode[LOCAL_FLAGS] & (termios.ICANON | termios.ECHO))
            if is_by_line or self._before is None:
                self._before = mode
            if is_by_line or not self._is_set:
                self._is_set = True
                tty.setcbreak(self._handle, termios.TCSANOW)
                self._write(ASK_FOR_PASTE_MARKS)
        return True

    def has_keys(self) -> bool:
        """Whether a read returns at once, because a key is there or the terminal is gone.

        A terminal that looked readable is not where its mode was changed: a read would then wait
        for Enter.
        """
        if not self.ready():
            return False
        waiting = array.array("i", [0])
        try:
            fcntl.ioctl(self._handle, termios.FIONREAD, waiting)
        except OSError:
            return True
        look = select.poll()
        look.register(self._handle, select.POLLIN)
        is_gone = any(event & select.POLLHUP for _, event in look.poll(0))
        return waiting[0] > 0 or is_gone

    def restore(self) -> None:
        """Set the mode that was there before, where the terminal is still ours."""
        if self._before is None or self.is_in_background():
            return
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(self._handle, termios.TCSANOW, self._before)
            self._write(NO_PASTE_MARKS)

    def pause(self, number: int, frame: object) -> None:
        """Stop as Ctrl-Z wants it, and give the terminal back before.

        The mode is set again by the first look at the keys after `fg`.
        """
        self.restore()
        self._is_set = False
        ours = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        # Here the program goes on after SIGCONT.
        signal.signal(signal.SIGTSTP, ours)

    def _write(self, text: bytes) -> None:
        """Write to the terminal, or not at all: one that stopped (Ctrl-S) must not stop us."""
        if os.environ.get("TERM", "dumb") == "dumb":
            return
        with suppress(OSError):
            flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY
            handle = os.open(os.ttyname(self._handle), flags)
            with suppress(OSError):
                os.write(handle, text)
            os.close(handle)


@contextmanager
def listening(handle: int) -> Iterator[Keys]:
    """Keys of a descriptor.

    A terminal reports single presses within the block, and is then restored, also while the program
    is stopped by Ctrl-Z.

    If the terminal belongs to another program (we run in the background), nothing is read from it.
    """
    if not os.isatty(handle):
        yield Keys(handle)
        return
    terminal = CbreakTerminal(handle)
    if terminal.is_in_background():
        yield Keys(None)
        return

    stops = signal.getsignal(signal.SIGTSTP) or signal.SIG_DFL
    try:
        terminal.ready()
        # A shell without job control ignores it, and so do we then.
        if stops != signal.SIG_IGN:
            signal.signal(signal.SIGTSTP, terminal.pause)
        yield Keys(handle, terminal)
    finally:
        signal.signal(signal.SIGTSTP, stops)
        terminal.restore()


class Display:
    """What the operator sees of a session; this one passes messages on and shows nothing else."""

    def __init__(self, sink: Callable[[str], object]) -> None:
        self._sink = sink

    def report(self, line: str) -> None:
        """A message that stays, above the line that is drawn anew."""
        self._sink(line)

    def draw(self, line: str) -> None:
        """A line that the next one replaces."""

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        """A sample of a trial when it is written; must return at once."""


class StatusLine(Display):
    """Draws the line on a sink, and writes messages in its place.

    sink: returns whether it took the text. columns: current width of the terminal, 0 where nothing
    can be drawn; seconds: length of a trial, if set.
    """

    def __init__(
        self,
        sink: Callable[[str], bool],
        columns: Callable[[], int],
        seconds: float | None = None,
    ) -> None:
        super().__init__(sink)
        self._columns = columns
        self._of = "" if seconds is None else f" of {seconds:g}"
        self._drawn = False
        self._due_ns = 0

    def report(self, line: str) -> None:
        """Write a message that stays, in place of the status."""
        if self._write(visible_lines(line)):
            self._drawn = False

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        """Draw the newest sample of a trial, if it is time to redraw."""
        if now_ns < self._due_ns or not trial.started:
            return
        self._due_ns = now_ns + REDRAW_NS
        self.draw(status_text(trial, measured, self._of))

    def draw(self, line: str) -> None:
        """Draw a line in place of the last one that was drawn; nothing without a terminal."""
        columns = self._columns()
        # One column less: a full line would wrap, and the next redraw would miss half of it.
        if columns and self._write(line[: columns - 1]):
            self._drawn = True

    def _write(self, line: str) -> object:
        return self._sink(f"{OVER_THE_LINE_ABOVE if self._drawn else ''}{line}")


def status_text(trial: TrialRecorder, measured: SourceReading, of: str = "") -> str:
    """The line; forces (or fields) are less the bias, - for a finger that is not valid."""
    quality = trial.quality
    values = measured.values - np.nan_to_num(quality.bias)
    forces = np.linalg.norm(values.reshape(-1, 3), axis=1)
    # fields are large numbers
    decimals = 2 if quality.unit == "N" else 0
    # A finger that is not valid shows a dash: its last force would look like a reading.
    fingers = ""
    for force, good in zip(forces, measured.valid, strict=True):
        fingers += f" {force:5.{decimals}f}" if good else "     -"
    return f"{trial.t_s:.1f}{of} s, {quality.lost} lost; forces{fingers} {quality.unit}"


def columns_of(stream: TextIO) -> int:
    """Width of a terminal that can redraw a line; 0 for other streams and lost terminals."""
    if os.environ.get("TERM", "dumb") == "dumb" or not stream.isatty():
        return 0
    try:
        return os.get_terminal_size(stream.fileno()).columns or COLUMNS
    except OSError:
        return 0


@dataclass(frozen=True)
class RunContext:
    """What surrounds a run: its clock, its operator, and what ends it.

    host_ns: CLOCK_MONOTONIC, ns, which also stamps a camera's frames.
    """

    clock: Any
    keys: Keys
    display: Display
    stopped: Callable[[], bool]
    host_ns: Callable[[], int] = time.monotonic_ns


def context_of(
    keys: Keys, stopped: Callable[[], bool], seconds: float | None
) -> RunContext:
    """A run at this terminal, with the status on stderr. seconds: length of a trial, if set."""
    # A sink: a terminal that stops reading must not stop the recording.
    sink = stream_sink(sys.stderr)
    status = StatusLine(sink, lambda: columns_of(sys.stderr), seconds)
    return RunContext(RunClock(), keys, status, stopped)
