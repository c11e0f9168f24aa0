"""Where samples come from: one table of URLs, the same for every command, and the files with them.

    usb://ft232h?number=0                     a bridge on USB
    i2c://1                                   the board's own bus, /dev/i2c-1
    virtual://ft232h?scene=pull-soft-ball     the same driver on an emulated bridge; also seed,
              &fault=nack:3@1.5%2B0.2         trial, and faults (drivers/virtual/virtual_hand.py)
    lsl://NAME?unit=N                         a stream of the lab streaming layer (extra `lsl`)
    -, stdin://                               lines of any program: JSON objects, or CSV below a
                                              header; paced=1: a recording, at its own pace
    unix:///PATH                              datagrams of lines to a file with permissions 0600
    serial:///dev/ttyACM0?baud=115200         lines of a serial port (extra `serial`)
    sim://SCENE?seed=S&trial=N&trials=K       trials of a scene, simulated now, end to end
    replay://PATH, PATH                       a recorded trial, at its own pace
    replay://SET#N, SET#N                     trial N (or its name) of a data set

A hand also has layout=mux (drivers/layout.py), averages=32. Lines also have map=FILE
(a column map), unit=N (without a map), rate_hz=150 (else measured) and stamps=arrival or sender.
What comes over a network is piped:
nc -l 9000 | holdfast run --source -
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit

import msgspec

from holdfast.core.contract import Unit
from holdfast.core.errors import UsageError
from holdfast.core.schema import checked
from holdfast.drivers.bridges import BRIDGES

STANDARD_INPUT = "-"
"""The same as stdin://."""
REPLAY, SIM = "replay://", "sim://"
MOST_DIGITS = 17
Count = Annotated[int, msgspec.Meta(ge=0, lt=10**MOST_DIGITS)]
RateHz = Annotated[float, msgspec.Meta(ge=1.0, le=10_000.0)]


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """None."""


class HandOptions(NoOptions, frozen=True):
    """Of a hand on a bus."""

    layout: str = "mux"
    # the chip averages 2^0 to 2^5 conversions, and its register has no other values
    averages: Literal[1, 2, 4, 8, 16, 32] = 32
    bus_hz: Count = 400_000
    number: Count = 0


class VirtualOptions(HandOptions, frozen=True):
    """Of an emulated hand, and the scene that it is in."""

    scene: str = ""
    trial: Count = 0
    seed: Count = 0
    fault: tuple[str, ...] = ()


class SceneOptions(NoOptions, frozen=True):
    """Of trials of a scene."""

    seed: Count = 0
    trial: Count = 0
    trials: Count = 1
    rate_hz: float | None = None


class StreamOptions(NoOptions, frozen=True):
    """Of a stream; None where it says them itself."""

    unit: Unit | None = None
    rate_hz: RateHz | None = None


class LineOptions(StreamOptions, frozen=True):
    """Of lines. map: the file of a column map."""

    map: str | None = None
    stamps: Literal["arrival", "sender"] = "arrival"


class StdinOptions(LineOptions, frozen=True):
    """Of standard input. paced: a recording, at its own pace; None where a file tells."""

    paced: bool | None = None


class SerialOptions(LineOptions, frozen=True):
    """Of a serial port."""

    baud: Count = 115_200


SCHEMES: dict[str, type[NoOptions]] = {
    "usb": HandOptions,
    "i2c": HandOptions,
    "virtual": VirtualOptions,
    "lsl": StreamOptions,
    "stdin": StdinOptions,
    "unix": LineOptions,
    "serial": SerialOptions,
    "sim": SceneOptions,
    "replay": NoOptions,
}
"""Scheme -> what may stand behind the ? of its URLs."""
HANDS = ("usb", "i2c", "virtual")
LINES = ("stdin", "unix", "serial")


class SourceUrl(NamedTuple):
    """A URL in parts: scheme, name or path, and options of the scheme's Struct."""

    url: str
    scheme: str
    name: str
    options: Any


def source_url(url: str) -> SourceUrl:
    """The parts of a source's URL. Raises UsageError."""
    if url == STANDARD_INPUT:
        url = "stdin://"
    # a path, and that of a replay, may have any letter in it
    if "://" not in url or url.startswith(REPLAY):
        return SourceUrl(url, "replay", url.removeprefix(REPLAY), NoOptions())

    parts = split_url(url)
    if parts.scheme in ("tcp", "udp"):
        raise UsageError(
            f"--source {url[:80]!r}: samples do not come over a network",
            next_step="pipe them, as nc -l 9000 | holdfast run --source -",
        )
    if parts.scheme not in SCHEMES:
        schemes = ", ".join(f"{scheme}://" for scheme in SCHEMES)
        raise UsageError(f"{url[:80]!r}: no such source", next_step=f"one of {schemes}")

    name = unquote(parts.netloc + parts.path)
    if parts.scheme in ("usb", "virtual") and name not in BRIDGES:
        step = f"one of {', '.join(BRIDGES)}"
        raise UsageError(f"{url!r}: no bridge {name!r}", next_step=step)
    # an option that is given twice counts by its last value, but for faults
    raw: dict[str, Any] = parse_qs(parts.query, keep_blank_values=True)
    raw = {key: raw[key] if key == "fault" else raw[key][-1] for key in raw}
    kind = SCHEMES[parts.scheme]
    options = checked(raw, kind, f"{parts.scheme}://", UsageError, strict=False)
    return SourceUrl(url, parts.scheme, name, options)


def split_url(url: str) -> SplitResult:
    """The parts of a URL. Raises UsageError."""
    try:
        return urlsplit(url)
    except ValueError as error:
        raise UsageError(
            f"{url[:80]!r} is not a URL ({error})",
            next_step="write SCHEME://NAME?key=value",
        ) from None


def is_standard_input(url: str) -> bool:
    """Whether a source is what is piped into the program, so that no key can be read from there."""
    return url == STANDARD_INPUT or url.startswith("stdin:")


def is_hand(url: str) -> bool:
    """Whether a URL is a hand or a stream, which has no end of its own, unlike a recording."""
    scheme = "stdin" if url == STANDARD_INPUT else split_url(url).scheme
    return scheme in (*HANDS, "lsl", *LINES)


def stream_name(name: str) -> str:
    """A name of an LSL stream. Raises UsageError."""
    # liblsl finds a stream by a query in which the name stands between quotes
    if not name or "'" in name:
        raise UsageError(
            f"{name[:40]!r} is no name of a stream", next_step="lsl://NAME"
        )
    return name
