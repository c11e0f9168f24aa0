"""Lines that may move a hand: what a sender writes into them, and which ones a receiver obeys.

A line is a JSON object (or a row of cells with the same two numbers) that goes one way, over UDP, a
Unix socket or a serial port. `session` is the number of the sender's run, `sequence` rises from
line to line; both are whole, from 0 to 2^53 - 1.

    {"session":4127381920113,"sequence":812,"mode":"tighten","target_n":9.4}

A receiver obeys these rules:

1. What is not one JSON object of finite numbers is skipped.
2. It keeps one session. A line of another session is skipped until none of the session's own lines
   has been obeyed for 300 ms (`silence_ns`); then any session may begin, at any sequence.
3. Within a session only rising sequences are obeyed, and none that is more than a second of samples
   ahead (`most_ahead`), so that a wrong number cannot keep out the right ones.
4. With a shared key (line_key.py) a line without the right code is skipped, and a session begins
   only above the newest pair of session and sequence that was obeyed, so nothing is obeyed twice.

Only an obeyed line counts as one of the session: skipped ones never keep it alive or end it.

Without a key the session is a random number of 53 bits. So a sender that cannot read the link does
not hit the session while it lives: this stops blind forgery only. A sender that reads the link, or
that comes before the genuine one and stays, is obeyed. With a key neither is.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from typing import TypeVar

from holdfast.core.errors import OutputError
from holdfast.core.line_key import LARGEST, LinkKey
from holdfast.core.reading import Json

SILENCE_NS = 300_000_000
"""A session ends when none of its lines has been obeyed for longer."""
LONGEST_LINE = 16 << 10
"""Bytes. A sample of 64 sensors needs 5,000."""
MOST_BRACKETS = 256
"""Lists and objects in a line; thousands inside one another exhaust Python's stack."""
LARGEST_WHOLE = 2**63 - 1
"""Of other whole numbers, such as times in ns."""

NOT_UNDERSTOOD, NOT_SEALED = "not understood", "without the right code"
OTHER_SESSION, NOT_RISING = "of another session", "not rising"
TOO_FAR, REPLAYED = "too far ahead", "of an old session"

T = TypeVar("T")


class LineRefused(ValueError):
    """A line that is skipped. kind: one of the words above, to count by."""

    def __init__(self, kind: str, why: str = "") -> None:
        self.kind = kind
        super().__init__(f"{kind} ({why})" if why else kind)


# -- one line


def fields_of(line: bytes) -> Json:
    """The members of a line that is one JSON object of finite numbers.

    Raises ValueError, with the reason.
    """
    if len(line) > LONGEST_LINE:
        raise ValueError("too long")
    if line.count(b"[") + line.count(b"{") > MOST_BRACKETS:
        raise ValueError("too many brackets")
    try:
        fields = _DECODER.decode(line.decode("utf-8"))
    except RecursionError:
        raise ValueError("nested too deep") from None
    if not isinstance(fields, dict):
        raise ValueError("no JSON object")
    return fields


def _not_finite(text: str) -> float:
    raise ValueError(f"{text} is not finite")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _not_finite(text[:20])


def _whole(text: str) -> int:
    # the length first: Python takes long to read thousands of digits
    if len(text) > 20 or abs(value := int(text)) > LARGEST_WHOLE:
        raise ValueError("a whole number has more than 63 bits")
    return value


def _distinct(pairs: list[tuple[str, object]]) -> Json:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise ValueError("a name stands twice")
    return members


_DECODER = json.JSONDecoder(
    parse_constant=_not_finite,
    parse_float=_finite,
    parse_int=_whole,
    object_pairs_hook=_distinct,
)


def number_of(fields: Json, name: str) -> int:
    """Take `session` or `sequence` out of the members. Raises ValueError."""
    value = fields.pop(name, None)
    # in Python, true is an int
    if type(value) is not int or not 0 <= value <= LARGEST:
        raise ValueError(f"no {name} from 0 to 2^53 - 1")
    return value


# -- the rule


class SessionRule:
    """Which session and sequences a receiver obeys. It has no clock: every call brings the time.

    most_ahead: sequences in a second of samples; where lines may be further apart, also those
    between two lines. after: with a key, the newest (session, sequence) obeyed so far; None without
    one. session: the one that is kept or was kept last, None before the first.
    """

    def __init__(
        self,
        most_ahead: int,
        silence_ns: int = SILENCE_NS,
        after: tuple[int, int] | None = None,
    ) -> None:
        self._most_ahead = most_ahead
        self._silence_ns = silence_ns
        self._after = after
        self._sequence = -1
        self._obeyed_ns = 0
        self.session: int | None = None

    def lives(self, now_ns: int) -> bool:
        """Whether a session is kept now."""
        silent_ns = now_ns - self._obeyed_ns
        return self.session is not None and silent_ns <= self._silence_ns

    def refusal(self, session: int, sequence: int, now_ns: int) -> str:
        """Why a line is skipped, "" where it may be obeyed. Changes nothing."""
        if not self.lives(now_ns):
            replayed = self._after is not None and (session, sequence) <= self._after
            return REPLAYED if replayed else ""
        if session != self.session:
            return OTHER_SESSION
        if sequence <= self._sequence:
            return NOT_RISING
        return TOO_FAR if sequence - self._sequence > self._most_ahead else ""

    def obeyed(self, session: int, sequence: int, now_ns: int) -> None:
        """A line that was not refused is obeyed: it keeps its session, or begins it."""
        self.session = session
        self._sequence = sequence
        self._obeyed_ns = now_ns
        if self._after is not None:
            self._after = (session, sequence)


# -- both ends of a link of JSON lines


class LineReceiver:
    """Reads the lines of one link by all the rules.

    key: of the link, None without one. needs_session: whether a line must have `session` and
    `sequence`; without a key, and on a link that only its owner can write to, a line without either
    may be obeyed. began: called with the number of each new session.
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        most_ahead: int,
        *,
        silence_ns: int = SILENCE_NS,
        key: LinkKey | None = None,
        needs_session: bool = True,
        began: Callable[[int], object] | None = None,
    ) -> None:
        after = None if key is None else (key.newest_seen(), -1)
        self.rule = SessionRule(most_ahead, silence_ns, after)
        self._key = key
        self._now_ns = now_ns
        self._needs_session = needs_session or key is not None
        self._began = began

    def take(self, line: bytes, read: Callable[[Json], T]) -> T:
        """What `read` makes of the other members of a line that is to be obeyed.

        line: without its line end. read: raises ValueError for what it does not understand; the
        line is then skipped. Raises LineRefused.
        """
        try:
            return self._take(line, read)
        except LineRefused:
            raise
        except ValueError as error:
            raise LineRefused(NOT_UNDERSTOOD, str(error)) from None

    def _take(self, line: bytes, read: Callable[[Json], T]) -> T:
        fields = fields_of(self._opened(line))
        # a sealed line is read also where the receiver has no key
        fields.pop("mac", None)
        if not self._needs_session and not {"session", "sequence"} & fields.keys():
            return read(fields)

        session = number_of(fields, "session")
        sequence = number_of(fields, "sequence")
        now_ns = self._now_ns()
        if kind := self.rule.refusal(session, sequence, now_ns):
            raise LineRefused(kind)

        value = read(fields)
        is_new = session != self.rule.session
        self.rule.obeyed(session, sequence, now_ns)
        if is_new and self._began is not None:
            self._began(session)
        return value

    def _opened(self, line: bytes) -> bytes:
        try:
            return line if self._key is None else self._key.opened(line)
        except ValueError as error:
            raise LineRefused(NOT_SEALED, str(error)) from None


class LineSender:
    """Writes the session into the lines of one link, and seals them where it has a key.

    The caller's lines are JSON objects with a rising `sequence`.
    """

    def __init__(self, session: int, key: LinkKey | None = None) -> None:
        self.session = session
        self.key = key

    @classmethod
    def begin(cls, key: LinkKey | None = None) -> LineSender:
        """A new session. Raises OutputError, UsageError."""
        return cls(random_session() if key is None else key.next_session(), key)

    def unsealed(self, line: str) -> str:
        """A line with its session, and without a code."""
        return f'{{"session":{self.session},{line[1:]}'

    def line(self, line: str) -> bytes:
        """A line as it is sent, without a line end."""
        data = self.unsealed(line).encode()
        return data if self.key is None else self.key.sealed(data)


def random_session() -> int:
    """A number that cannot be guessed, 53 bits."""
    return int.from_bytes(os.urandom(8), "big") & LARGEST


def store_in_thread(
    key: LinkKey | None, report: Callable[[str], object]
) -> Callable[[int], None]:
    """A `began` for a receiver in a live loop, which never waits for a disk.

    report: receives a line where the number cannot be stored.
    """
    from threading import Thread

    def store(session: int) -> None:
        try:
            if key is not None:
                key.store_seen(session)
        except OutputError as error:
            report(f"an old session could be replayed after a restart: {error}")

    def began(session: int) -> None:
        Thread(target=store, args=(session,), name="session", daemon=True).start()

    return began
