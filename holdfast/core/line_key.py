"""A shared key for the lines of a link: a program without it can neither write nor replay them.

A key is a file with 32 to 64 printable characters, which only its owner may read:

    umask 077; openssl rand -hex 32 > link.key

A sealed line ends with a code: HMAC-SHA256 (RFC 2104) by the key, over the link's name, a line feed
and everything that stands before the code, as 64 hexadecimal digits. In a JSON object the code is
the last member, in a row of cells the last cell:

    {"session":1795622400000000,"sequence":7,"opening":true,"mac":"5bd2.."}
    1795622400000000,7,0.1,0.2,0.3,5bd2..

The name keeps the lines of one link from being replayed on another with the same key.

A code alone does not say when a line was written. So session numbers rise: the sender stores its
last one in a file beside the key, KEY.<link>.sent, and takes the next, or the time of day in us
where that is larger: a lost file or a clock that is wrong for once blocks nothing. A receiver takes
no session below the newest that it has taken, and stores that one in KEY.<link>.seen. A challenge
by the receiver would need no file, but an answer: a line goes one way.
"""

from __future__ import annotations

import hmac
import stat
import time
from dataclasses import dataclass
from pathlib import Path

from holdfast.core.errors import AccessDenied, DataNotFound, UsageError
from holdfast.core.reading import text_of
from holdfast.core.writing import write_whole

SHORTEST_KEY, LONGEST_KEY = 32, 64
"""Characters. A longer one than a block of SHA-256 would be hashed first."""
DIGITS = 64
"""Hexadecimal digits of a code."""
LARGEST = 2**53 - 1
"""Of the numbers of sessions and lines: also JavaScript has all whole numbers up to here."""
MAKE_A_KEY = "umask 077; openssl rand -hex 32 > FILE"


@dataclass(frozen=True)
class LinkKey:
    """The key of one link. link: its name, such as "grip". path: the file, without one None."""

    key: bytes
    link: str
    path: Path | None = None

    def code(self, before: bytes) -> bytes:
        """The code over what stands before it: 64 digits."""
        named = self.link.encode() + b"\n" + before
        return hmac.digest(self.key, named, "sha256").hex().encode()

    def sealed(self, line: bytes) -> bytes:
        """A line with its code. line: a JSON object or a row of cells, without a line end."""
        if line.endswith(b"}"):
            before = line[:-1]
            return before + b',"mac":"' + self.code(before) + b'"}'
        return line + b"," + self.code(line)

    def opened(self, line: bytes) -> bytes:
        """The line without its code. Raises ValueError where the code is missing or wrong."""
        is_object = line.endswith(b'"}')
        mark, end = (b',"mac":"', b'"}') if is_object else (b",", b"")
        at = max(len(line) - len(mark) - DIGITS - len(end), 0)
        before = line[:at]
        # the whole end is compared, so that nothing beside the code can be changed
        if not hmac.compare_digest(mark + self.code(before) + end, line[at:]):
            raise ValueError("its code is missing or wrong")
        return before + b"}" if is_object else before

    def next_session(self) -> int:
        """The number of a new session of lines that are sent; stored before it is used.

        Raises OutputError, UsageError.
        """
        session = max(self._stored("sent") + 1, time.time_ns() // 1000)
        if self.path is not None:
            write_whole(self._number_file("sent"), f"{session}\n")
        return session

    def newest_seen(self) -> int:
        """The newest session that was ever taken from this link, 0 for none. Raises UsageError."""
        return self._stored("seen")

    def store_seen(self, session: int) -> None:
        """Store the number of a session that is taken. Raises OutputError."""
        if self.path is not None:
            write_whole(self._number_file("seen"), f"{session}\n")

    def _number_file(self, what: str) -> Path:
        assert self.path is not None
        return self.path.with_name(f"{self.path.name}.{self.link}.{what}")

    def _stored(self, what: str) -> int:
        if self.path is None:
            return 0
        path = self._number_file(what)
        try:
            text = text_of(path).strip()
        except FileNotFoundError:
            return 0
        except (OSError, ValueError) as error:
            raise _no_number(path, str(error)) from None
        if not text.isdecimal() or len(text) > 16 or int(text) >= LARGEST:
            raise _no_number(path, f"{text[:40]!r} is no number of a session")
        return int(text)


def _no_number(path: Path, what: str) -> UsageError:
    return UsageError(
        what,
        where=path,
        cause="a damaged or an edited file",
        next_step="write the number of the last session into it, or make a new key",
    )


def read_key(path: Path, link: str) -> LinkKey:
    """The key of a file, for one link. Raises UsageError, DataNotFound, AccessDenied."""
    try:
        mode = path.stat().st_mode
        text = text_of(path).strip() if stat.S_ISREG(mode) else ""
    except FileNotFoundError:
        raise DataNotFound(
            "no such key", where=path, next_step=f"make one: {MAKE_A_KEY}"
        ) from None
    except PermissionError:
        raise AccessDenied("cannot be read by this user", where=path) from None
    except (OSError, ValueError):
        text = ""

    if not SHORTEST_KEY <= len(text) <= LONGEST_KEY or not _printable(text):
        raise UsageError(
            f"not a key: {SHORTEST_KEY} to {LONGEST_KEY} printable characters on one line",
            where=path,
            next_step=f"make one: {MAKE_A_KEY}",
        )
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise UsageError(
            "other users of this machine can read this key",
            where=path,
            next_step=f"chmod 600 {path}",
        )
    return LinkKey(text.encode(), link, path)


def _printable(text: str) -> bool:
    return text.isascii() and text.isprintable() and " " not in text
