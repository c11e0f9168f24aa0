"""Every error Holdfast raises on purpose: one tree, whose root is HoldfastError.

Each message is one line that says what, where, the likely cause and the next step. `exit_code` is
what a command ends with; an error inherits it.

Libraries that only an extra installs: what is said when one of them is missing.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST_LINE = 2000
"""Characters of one message; a name may have a hundred thousand."""


def command(*words: object) -> str:
    """A command to try next, which can be pasted.

    >>> command("check", "my trials")
    "holdfast check 'my trials'"
    """
    return shlex.join(["holdfast", *map(str, words)])


def count_of(n: int, noun: str, plural: str = "") -> str:
    """How many, and of what. plural: where it is more than the noun and an s.

    >>> count_of(1, "trial"), count_of(1200, "sample"), count_of(0, "person", "people")
    ('1 trial', '1200 samples', '0 people')
    """
    return f"{n} {noun if n == 1 else plural or noun + 's'}"


def visible(text: str) -> str:
    r"""The text, with what does not print as its escape: ESC as \x1b, an RTL override as \u202e.

    A terminal obeys such characters: they move its cursor, rename its window or hide the text
    before them.

    >>> visible("cup\x1b[2J")
    'cup\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode("ascii")
        for one in text
    )


def one_line(text: str) -> str:
    """The same on one line: white space as single spaces, a very long text shortened inside."""
    line = visible(" ".join(text.split()))
    if len(line) <= LONGEST_LINE:
        return line
    return f"{line[: LONGEST_LINE // 2]} .. {line[-LONGEST_LINE // 2 :]}"


def visible_lines(text: str) -> str:
    """Several lines, each made safe."""
    return "\n".join(visible(line) for line in text.split("\n"))


def listed(names: list[str], most: int = 8) -> str:
    """Names for a message: the first ones, and how many more there are.

    >>> listed(["X1", "Y1", "Z1"], most=2)
    'X1, Y1 and 1 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(f"{name:.40}" for name in names[:most]) + more


class HoldfastError(Exception):
    """Root of all errors raised on purpose.

    What happened, where, the likely cause, the next step.
    """

    exit_code = 1

    def __init__(
        self, what: str, *, where: str | Path = "", cause: str = "", next_step: str = ""
    ) -> None:
        self.what = what
        self.where = str(where)
        self.cause = cause
        self.next_step = next_step
        super().__init__(self._line())

    def _line(self) -> str:
        """The message: place, fact, likely cause, next step."""
        parts = [f"{self.where}: {self.what}" if self.where else self.what]
        if self.cause:
            parts.append(f"likely cause: {self.cause}")
        if self.next_step:
            parts.append(f"next: {self.next_step}")
        return one_line("; ".join(parts))


class UsageError(HoldfastError):
    """An argument on the command line is not allowed."""

    exit_code = 2


class DataError(HoldfastError):
    """A recording or a data set cannot be used."""

    exit_code = 3


class DataNotFound(DataError):
    """No such set, folder or file."""


class EmptyRecording(DataError):
    """No rows, or too few to work with."""


class ColumnError(DataError):
    """Columns are missing, unknown, doubled or out of order."""


class NotANumber(DataError):
    """Text where a number belongs."""


class TimeError(DataError):
    """Time stands still, runs backwards, or has gaps."""


class RateError(DataError):
    """A sampling rate that does not fit the model, or carries none of its bands."""


class UnitError(DataError):
    """A unit that does not fit the model."""


class ChannelError(DataError):
    """A number of channels that does not fit the model or is no multiple of three."""


class LabelError(DataError):
    """What labels need (an object's mass, its action, its truth) is missing or broken."""


class TagError(LabelError):
    """Printed tags contradict each other, or their stated size: lengths in mm would be wrong."""


class CardError(DataError):
    """A scene's card holds an unknown key, a value out of range, or a contradiction."""


class ClassMissing(DataError):
    """A class without a single window."""


class TooFewGroups(DataError):
    """Fewer people (or blocks) than a grouped split needs."""


class TooLittleToAdapt(DataError):
    """Too few hand-overs of a person, or too little holding."""


class SetLocked(DataError):
    """A set that is kept for a last test was given to something that chooses."""


class ModelError(HoldfastError):
    """A model file cannot be used."""

    exit_code = 4


class NotAModel(ModelError):
    """Not an ONNX file sealed by Holdfast."""


class BrokenSeal(ModelError):
    """The file was truncated or altered after it was sealed."""


class GoldenMismatch(ModelError):
    """This runtime does not reproduce the golden sequences stored in the file."""


class RuntimeRefused(ModelError):
    """A version of onnxruntime known to answer wrongly."""


class VerificationFailed(ModelError):
    """The exported file and the reference disagree."""


class NotAdapted(ModelError):
    """There is no adaptation to undo, or no base to restore."""


class WorseThanBase(ModelError):
    """An adaptation would answer worse than its base does."""


class NotCompilable(ModelError):
    """The file holds what the C form does not have."""


class LibraryRefused(ModelError):
    """There is no compiled library of the model, or it is another one."""


class ArtifactError(HoldfastError):
    """A training artifact is missing, foreign or unsafe."""

    exit_code = 4


class WorkersLost(HoldfastError):
    """A process or a cluster that computes jobs has died."""


class OutputError(HoldfastError):
    """A result cannot be written."""

    exit_code = 5


class CompilerFailed(OutputError):
    """There is no C compiler, or it is too old, or it fails."""


class DeviceError(HoldfastError):
    """The hand, or the camera next to it, cannot be read."""

    exit_code = 6


class DeviceNotFound(DeviceError):
    """No such bridge, or no finger answers."""


class AccessDenied(DeviceError):
    """The bridge is there, but this user may not open it."""


class LibraryMissing(DeviceError):
    """No libusb, or the library of an extra is not installed."""


class DeviceLost(DeviceError):
    """Unplugged, or no longer on the bus."""


class TransferFailed(DeviceError):
    """A time-out, a stall, or an answer to another request."""


class BusStuck(DeviceError):
    """SDA or SCL is held low."""


class WrongDevice(DeviceError):
    """Another chip at the address, or one that does not keep its configuration."""


class CameraUnavailable(DeviceError):
    """No camera, or one that cannot be opened."""


@contextmanager
def needs_extra(name: str) -> Iterator[None]:
    """Around the imports of an extra's libraries. Raises LibraryMissing, which names the extra."""
    try:
        yield
    except ImportError as error:
        raise LibraryMissing(
            f"the library {error.name or '?'} does not load ({error})",
            cause=f"only the extra `{name}` installs it",
            next_step=f"pip install 'holdfast[{name}]'",
        ) from None
