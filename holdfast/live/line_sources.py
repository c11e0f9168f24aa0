"""URLs of lines that any program sends: JSON objects, or CSV below a header.

    -, stdin://                           standard input; paced=1: a recording, at its own pace,
                                          as a file is (< trial.csv) without being told
    tcp://HOST:PORT                       connects; listen=1: lets one client at a time connect
    udp://HOST:PORT                       datagrams, one line or several in each
    unix:///PATH                          datagrams to a socket file with permissions 0600: the
                                          safe choice on one board
    serial:///dev/ttyACM0?baud=115200     a serial port

Options of all: map=FILE (a column map), unit=N (without a map; or uT, count), rate_hz=150 (else
measured), stamps=arrival or sender, key=FILE (a shared key). A source that listens does so on this
machine only, unless network=1 says otherwise.
"""

from __future__ import annotations

import ipaddress
import os
import socket
import stat
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from holdfast.core.column_map import ColumnMap, read_column_map
from holdfast.core.contract import UNITS, Unit
from holdfast.core.errors import CardError, DeviceNotFound, UsageError
from holdfast.core.line_port import Datagrams, LineUrl, line_url, listening
from holdfast.core.line_session import store_in_thread
from holdfast.core.tally import Tally
from holdfast.drivers.line_feeds import (
    DatagramFeed,
    Feed,
    SerialEnd,
    StandardInput,
    StreamFeed,
    TcpCaller,
    TcpListener,
)
from holdfast.drivers.line_source import LineOptions, LineSource
from holdfast.drivers.sample_lines import SampleReader
from holdfast.live.sources import STANDARD_INPUT, ToForce

LINK = "samples"
"""The name of these lines, under which a key seals them."""
COMMON = ("map", "unit", "rate_hz", "stamps")
OPTIONS = {
    "stdin": ("paced",),
    "tcp": ("listen", "network"),
    "udp": ("network",),
    "unix": (),
    "serial": ("baud",),
}
STAMPS = ("arrival", "sender")
DEFAULT_BAUD = 115200
CONNECT_S = 5.0
EXAMPLES = (
    "-, tcp://127.0.0.1:9000, udp://127.0.0.1:9000 or serial:///dev/ttyACM0?baud=115200"
)
Report = Callable[[str], None]


@dataclass(frozen=True)
class LineWords:
    """A checked URL. unit: of the values without a map."""

    where: LineUrl
    column_map: ColumnMap | None
    unit: Unit
    options: LineOptions


def read_line_url(url: str) -> LineWords:
    """Check a URL, and read its column map and its key; opens nothing else.

    Raises UsageError, a DataError for map and key, AccessDenied.
    """
    where = _where(url)
    scheme = where.parts.scheme
    for name in where.options:
        if name not in (*COMMON, *OPTIONS[scheme]):
            allowed = ", ".join((*COMMON, "key", *OPTIONS[scheme]))
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

    key = words.where.key
    began = None if key is None else store_in_thread(key, report)
    reader = SampleReader(column_map, words.unit, key=key, began=began)
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
        return line_url("stdin://" if url == STANDARD_INPUT else url, LINK)
    except ValueError as error:
        raise _not_an_address(url, str(error)) from None


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
        "tcp": _tcp,
        "udp": _udp,
        "unix": _datagrams,
        "serial": _serial,
    }
    return openers[where.parts.scheme](where, clock, report)


def _stdin(where: LineUrl, clock: Any, report: Report) -> Feed:
    if where.parts.netloc or where.parts.path:
        raise _not_an_address(where.url, "nothing but options stands behind stdin://")
    return StreamFeed("stdin", StandardInput(), report)


def _address(where: LineUrl) -> tuple[str, int]:
    """(host, port) of an IP URL."""
    host, port = where.parts.hostname, where.parts.port
    if not host or port is None or where.parts.path:
        raise _not_an_address(where.url, "host or port is missing")
    return host, port


def _require_local(where: LineUrl, report: Report) -> None:
    """A port that others can reach must be asked for."""
    host, _ = _address(where)
    network = _word(where.options, "network", ("0", "1")) == "1"
    if not network and not _is_loopback(host):
        raise UsageError(
            f"{where.url[:80]!r} would let other machines send samples, which move the hand",
            next_step=f"{where.parts.scheme}://127.0.0.1:PORT, or add network=1 and key=FILE",
        )
    if network and where.key is None:
        report(
            f"{where.parts.scheme}://{where.parts.netloc}: without key=FILE, a program that reads "
            "this network can send samples, which move the hand"
        )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _udp(where: LineUrl, clock: Any, report: Report) -> Feed:
    _require_local(where, report)
    return _datagrams(where, clock, report)


def _datagrams(where: LineUrl, clock: Any, report: Report) -> Feed:
    with ExitStack() as stack:
        listener = listening(where, LINK, stack)
        listener.setblocking(False)
        name = f"{where.parts.scheme}://{where.parts.netloc}{where.parts.path}"
        feed = DatagramFeed(name, Datagrams(listener), stack.pop_all().close)
    return feed


def _tcp(where: LineUrl, clock: Any, report: Report) -> Feed:
    host, port = _address(where)
    name = f"tcp://{where.parts.netloc}"
    if _word(where.options, "listen", ("0", "1")) == "0":
        if "network" in where.options:
            raise UsageError(
                "network=1 is for a port that listens", next_step="listen=1"
            )
        return StreamFeed(name, _caller(name, host, port, clock), report)

    _require_local(where, report)
    tally = Tally(name, report, clock.now_ns)
    try:
        listener = socket.create_server((host, port))
    except (OSError, OverflowError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise UsageError(
            f"{name}: cannot listen: {what}", next_step="choose another port"
        ) from None

    def refused() -> None:
        tally.count(
            "connections refused", "another connection is refused: one at a time"
        )

    return StreamFeed(name, TcpListener(listener, clock.now_ns, refused), report)


def _caller(name: str, host: str, port: int, clock: Any) -> TcpCaller:
    try:
        connection = socket.create_connection((host, port), CONNECT_S)
    except (OSError, OverflowError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise DeviceNotFound(
            f"cannot connect: {what}",
            where=name,
            cause="nothing listens there yet, or a firewall is between",
            next_step="start the sender first, or let it connect: listen=1",
        ) from None
    # the address, and not the name: a look-up may take seconds
    return TcpCaller(connection, connection.getpeername(), clock.now_ns)


def _serial(where: LineUrl, clock: Any, report: Report) -> Feed:
    from holdfast.live.links import open_port, opening_error

    baud = where.options.get("baud", str(DEFAULT_BAUD))
    path = where.path
    if where.parts.netloc or not path.strip("/"):
        raise _not_an_address(where.url, "serial:///dev/ttyX, with three slashes")
    if not baud.isdecimal() or len(baud) > 9:
        raise UsageError(
            f"baud={baud[:40]!r} is not a whole number", next_step="baud=115200"
        )

    def open_again() -> int:
        return open_port(path, int(baud))

    try:
        handle = open_again()
    except OSError as error:
        raise opening_error(path, error) from None
    return StreamFeed(
        f"serial://{path}", SerialEnd(handle, open_again, clock.now_ns), report
    )
