"""URLs of lines that any program sends: JSON objects, or CSV below a header.

    -, stdin://                           standard input; paced=1: a recording, at its own pace,
                                          as a file is (< trial.csv) without being told
    unix:///PATH                          datagrams to a socket file with permissions 0600
    serial:///dev/ttyACM0?baud=115200     a serial port

Options of all: map=FILE (a column map), unit=N (without a map; or uT, count), rate_hz=150 (else
measured), stamps=arrival or sender. What comes over a network is piped: nc -l 9000 | holdfast run
--source -
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from holdfast.core.column_map import ColumnMap, read_column_map
from holdfast.core.contract import UNITS, Unit
from holdfast.core.errors import CardError, UsageError
from holdfast.core.hand_lines import LineUrl, line_url, unix_listener
from holdfast.drivers.line_feeds import (
    DatagramFeed,
    Feed,
    SerialEnd,
    StandardInput,
    StreamFeed,
)
from holdfast.drivers.line_source import LineOptions, LineSource
from holdfast.drivers.sample_lines import SampleReader
from holdfast.live.sources import STANDARD_INPUT, ToForce

COMMON = ("map", "unit", "rate_hz", "stamps")
OPTIONS = {
    "stdin": ("paced",),
    "unix": (),
    "serial": ("baud",),
}
STAMPS = ("arrival", "sender")
DEFAULT_BAUD = 115200
EXAMPLES = "-, unix:///PATH or serial:///dev/ttyACM0?baud=115200"
NETWORK = ("tcp", "udp")
Report = Callable[[str], None]


@dataclass(frozen=True)
class LineWords:
    """A checked URL. unit: of the values without a map."""

    where: LineUrl
    column_map: ColumnMap | None
    unit: Unit
    options: LineOptions


def read_line_url(url: str) -> LineWords:
    """Check a URL, and read its column map; opens nothing else.

    Raises UsageError, and a DataError for the map.
    """
    where = _where(url)
    scheme = where.parts.scheme
    for name in where.options:
        if name not in (*COMMON, *OPTIONS[scheme]):
            allowed = ", ".join((*COMMON, *OPTIONS[scheme]))
            raise UsageError(
                f"{scheme}://: {name[:40]!r} is not known",
                next_step=f"allowed: {allowed}",
            )
    column_map = _column_map(where)
    unit: Unit = _word(where.options, "unit", UNITS)
    return LineWords(where, column_map, unit, _line_options(where, column_map))


def open_lines(
    url: str, clock: Any, report: Report, to_force: ToForce | None = None
) -> LineSource:
    """Open a source of lines, and wait for its first samples.

    Raises UsageError, a DataError for the column map, a DeviceError.
    """
    words = read_line_url(url)
    column_map = words.column_map
    unit = words.unit if column_map is None else column_map.unit_of_values
    if to_force is not None and unit != "uT":
        raise UsageError(
            f"--calibration maps a field in uT to a force, and these lines are in {unit}",
            next_step="leave it out, or say unit=uT",
        )

    reader = SampleReader(column_map, words.unit)
    feed = _feed(words.where, clock, report)
    with ExitStack() as on_error:
        on_error.callback(feed.close)
        report(f"{feed.name}: waiting for the first samples")
        source = LineSource(feed, reader, clock, report, words.options, to_force)
        on_error.pop_all()
    return source


# -- the words of a URL


def _where(url: str) -> LineUrl:
    try:
        where = line_url("stdin://" if url == STANDARD_INPUT else url)
    except ValueError as error:
        raise _not_an_address(url, str(error)) from None
    if where.parts.scheme in NETWORK:
        raise UsageError(
            f"--source {url[:80]!r}: samples do not come over a network",
            next_step="pipe them, as nc -l 9000 | holdfast run --source -",
        )
    return where


def _not_an_address(url: str, cause: str) -> UsageError:
    return UsageError(
        f"--source {url[:80]!r} is not an address", cause=cause, next_step=EXAMPLES
    )


def _word(options: dict[str, str], name: str, allowed: tuple[Any, ...]) -> Any:
    """A word of an option, the first one allowed where it is not given. Raises UsageError."""
    word = options.get(name, allowed[0])
    if word not in allowed:
        raise UsageError(
            f"{name}={word[:40]!r} is not known",
            next_step=f"{name}={'|'.join(allowed)}",
        )
    return word


def _column_map(where: LineUrl) -> ColumnMap | None:
    path = where.options.get("map")
    if path is None:
        return None
    if "unit" in where.options:
        raise UsageError("unit= beside a map", next_step="write the unit into the map")
    try:
        column_map = read_column_map(path)
    except FileNotFoundError:
        raise CardError("no such column map", where=path) from None
    # looked at here: a map that contradicts its hand card is refused before anything opens
    column_map.hand_card()
    return column_map


def _line_options(where: LineUrl, column_map: ColumnMap | None) -> LineOptions:
    options = where.options
    rate_hz = None if column_map is None else column_map.time.rate_hz
    if "rate_hz" in options:
        rate_hz = _rate(options["rate_hz"])
    paced = _word(options, "paced", ("0", "1")) == "1"
    if where.parts.scheme == "stdin" and "paced" not in options:
        # a file is there as a whole, and a pipe is written as time goes by
        paced = stat.S_ISREG(os.fstat(0).st_mode)
    return LineOptions(_word(options, "stamps", STAMPS), rate_hz, paced)


def _rate(text: str) -> float:
    try:
        rate_hz = float(text)
    except ValueError:
        rate_hz = 0.0
    # nan fails the comparison
    if not 1.0 <= rate_hz <= 10_000.0:
        raise UsageError(
            f"rate_hz={text[:40]!r} is no rate from 1 to 10000", next_step="rate_hz=150"
        )
    return rate_hz


# -- what they open


def _feed(where: LineUrl, clock: Any, report: Report) -> Feed:
    openers = {
        "stdin": _stdin,
        "unix": _datagrams,
        "serial": _serial,
    }
    return openers[where.parts.scheme](where, clock, report)


def _stdin(where: LineUrl, clock: Any, report: Report) -> Feed:
    if where.parts.netloc or where.parts.path:
        raise _not_an_address(where.url, "nothing but options stands behind stdin://")
    return StreamFeed("stdin", StandardInput(), report)


def _datagrams(where: LineUrl, clock: Any, report: Report) -> Feed:
    with ExitStack() as stack:
        listener = unix_listener(where, "samples", stack)
        name = f"unix://{where.parts.path}"
        feed = DatagramFeed(name, listener, stack.pop_all().close)
    return feed


def _serial(where: LineUrl, clock: Any, report: Report) -> Feed:
    from holdfast.drivers.serial_port import open_port

    baud = where.options.get("baud", str(DEFAULT_BAUD))
    path = where.path
    if where.parts.netloc or not path.strip("/"):
        raise _not_an_address(where.url, "serial:///dev/ttyX, with three slashes")
    if not baud.isdecimal() or len(baud) > 9:
        raise UsageError(
            f"baud={baud[:40]!r} is not a whole number", next_step="baud=115200"
        )

    def open_again() -> int:
        with open_port(path, int(baud)) as port:
            return os.dup(port.fileno())

    end = SerialEnd(open_again(), open_again, clock.now_ns)
    return StreamFeed(f"serial://{path}", end, report)
