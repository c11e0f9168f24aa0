"""Where samples come from: one table of URLs, the same for every command, and what opens each.

    usb://ft232h?number=0                     a bridge on USB
    i2c://1                                   the board's own bus, /dev/i2c-1
    virtual://ft232h?scene=falling-bottle     the same driver on an emulated bridge; also seed,
              &fault=nack:3@1.5%2B0.2         trial, and faults (drivers/virtual/virtual_hand.py)
    lsl://NAME?unit=N                         a stream of the lab streaming layer (extra `lsl`)
    -, stdin://                               lines of any program: JSON objects, or CSV below a
                                              header
    unix:///PATH                              datagrams of lines to a file with permissions 0600
    serial:///dev/ttyACM0?baud=115200         lines of a serial port (extra `serial`)
    sim://SCENE?seed=S&trial=N                a trial of a scene, simulated now
    replay://PATH, PATH                       a recorded trial, at its own pace
    replay://SET#N, SET#N                     trial N (or its name) of a data set

A hand also has chip=tmag5273 (drivers/chips.py), layout=mux (drivers/layout.py) and averages=32,
which are the chip's. Lines also have map=FILE
(a column map), unit=N and hand=CARD (without a map), rate_hz=150 (else measured); a stream of LSL
has hand=CARD too. What comes over a network is
piped: nc -l 9000 | holdfast run --source -
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple
from urllib.parse import parse_qs, unquote

import msgspec
import numpy as np

from holdfast.core.contract import FloatArray, Unit
from holdfast.core.errors import CardError, ColumnError, DataNotFound, UsageError
from holdfast.core.hand_card import HandCard, read_hand_card, too_many
from holdfast.core.schema import checked
from holdfast.core.source import Source, SourceUrl
from holdfast.drivers.bridges import open_bus as open_bridge
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.bus import BRIDGE
from holdfast.drivers.chips import DEFAULT_CHIP, driver_of, emulation_of
from holdfast.drivers.replay import PacedReplay, Replay, open_replay
from holdfast.live.running import say

if TYPE_CHECKING:
    from holdfast.core.column_map import ColumnMap
    from holdfast.drivers.bus import Bus
    from holdfast.drivers.hand import Hand
    from holdfast.drivers.line_feeds import Feed
    from holdfast.drivers.virtual.virtual_hand import VirtualHand

Report = Callable[[str], None]
ToForce = Callable[[FloatArray], FloatArray]
"""Field [sensors, 3] -> force [sensors, 3]."""
SetReader = Callable[[str, int | None], Replay]
"""(SET#N, channels) -> trial N of a labelled set, prepared. Sets are read by packages above."""
STANDARD_INPUT = "-"
"""The same as stdin://."""
REPLAY, SIM = "replay://", "sim://"
HANDS = ("usb", "i2c", "virtual")
LINES = ("stdin", "unix", "serial")
Count = Annotated[int, msgspec.Meta(ge=0)]
RateHz = Annotated[float, msgspec.Meta(ge=1.0, le=10_000.0)]


# -- the URLs


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Those of a source that has none."""


class HandOptions(NoOptions, frozen=True):
    """Of a hand on a bus. averages: None for what the chip's driver chooses."""

    chip: str = DEFAULT_CHIP
    layout: str = "mux"
    # the driver of the chip knows which numbers it has
    averages: Count | None = None
    bus_hz: Count = 400_000
    number: Count = 0


class VirtualOptions(HandOptions, frozen=True):
    """Of an emulated hand, and the scene that it is in."""

    scene: str = ""
    trial: Count = 0
    seed: Count = 0
    fault: tuple[str, ...] = ()


class SceneOptions(NoOptions, frozen=True):
    """Of a trial of a scene."""

    seed: Count = 0
    trial: Count = 0
    rate_hz: float | None = None


class StreamOptions(NoOptions, frozen=True):
    """Of a stream; None where it says them itself. hand: a hand card, by name or path."""

    unit: Unit | None = None
    rate_hz: RateHz | None = None
    hand: str | None = None


class LinesOptions(StreamOptions, frozen=True):
    """Of lines. map: the file of a column map."""

    map: str | None = None


class SerialOptions(LinesOptions, frozen=True):
    """Those of lines from a serial port."""

    baud: Annotated[int, msgspec.Meta(ge=50, le=4_000_000)] = 115_200


def source_url(url: str) -> SourceUrl:
    """The parts of a source's URL. Raises UsageError."""
    if url == STANDARD_INPUT:
        url = "stdin://"
    # a path, and that of a replay, may have any letter in it
    if "://" not in url or url.startswith(REPLAY):
        return SourceUrl(url, "replay", url.removeprefix(REPLAY), NoOptions())

    # not by urlsplit, which raises for a bracket in a name
    scheme, _, rest = url.partition("://")
    name, _, query = rest.partition("?")
    name = unquote(name)
    if scheme not in SCHEMES:
        what = f"{url[:80]!r}: no such source"
        raise UsageError(what, next_step=f"one of {_known()}")

    if scheme in ("usb", "virtual") and name != BRIDGE:
        step = f"{scheme}://{BRIDGE}"
        raise UsageError(f"{url!r}: no bridge {name!r}", next_step=step)

    # an option that is given twice counts by its last value, but for faults
    raw: dict[str, Any] = parse_qs(query, keep_blank_values=True)
    raw = {key: raw[key] if key == "fault" else raw[key][-1] for key in raw}
    kind = SCHEMES[scheme].options
    options = checked(raw, kind, f"{scheme}://", UsageError, strict=False)
    return SourceUrl(url, scheme, name, options)


def _known() -> str:
    return ", ".join(f"{scheme}://" for scheme in SCHEMES)


def is_standard_input(url: str) -> bool:
    """Whether a source is what is piped into the program, so that no key can be read from there."""
    return url == STANDARD_INPUT or url.startswith("stdin:")


def is_hand(url: str) -> bool:
    """Whether a URL is a hand or a stream, which has no end of its own, unlike a recording."""
    return source_url(url).scheme not in ("sim", "replay")


def stream_name(name: str) -> str:
    """A name of an LSL stream. Raises UsageError."""
    # liblsl finds a stream by a query in which the name stands between quotes
    if not name or "'" in name:
        raise UsageError(f"{name[:40]!r} is no stream", next_step="lsl://NAME")
    return name


# -- what opens them


@dataclass(frozen=True)
class _Opening:
    """What an opener gets beside the URL.

    clock: has now_ns, spend and wait_until. field: what a virtual hand's chips measure.
    """

    clock: Any
    report: Report
    to_force: ToForce | None = None
    field: Any = None
    read_set: SetReader | None = None


def open_live(
    url: str,
    *,
    clock: Any,
    report: Report,
    to_force: ToForce | None = None,
    field: Any = None,
    read_set: SetReader | None = None,
) -> Source:
    """Open and start a live source.

    clock: has now_ns, spend and wait_until; to_force: a calibration, for a hand; field: what a
    virtual hand's chips measure, in place of the recorded field of its scene; read_set: reads
    SET#N. Raises UsageError for an impossible URL, and the errors of the hand or the recording.
    """
    source = source_url(url)
    opening = _Opening(clock, report, to_force, field, read_set)
    return SCHEMES[source.scheme].open(source, opening)


def open_source(
    url: str,
    *,
    channels: int | None = None,
    read_set: SetReader | None = None,
) -> Replay:
    """A recording or trials of a scene.

    read_set: reads SET#N, prepared, with so many channels. Raises a DataError or UsageError.
    """
    source = source_url(url)
    if source.scheme == "sim":
        from holdfast.live.scene import simulated_stream

        stream = simulated_stream(source)
    elif source.scheme != "replay":
        raise UsageError(
            f"{url!r} is no recording", next_step=f"use {REPLAY}PATH or {SIM}SCENE"
        )
    # a folder may have a number sign in its name
    elif read_set and "#" in source.name and not Path(source.name).exists():
        return read_set(source.name, channels)
    elif not Path(source.name).exists():
        raise DataNotFound(
            "no such file, and a URL begins with its scheme",
            where=url[:80],
            next_step=f"one of {_known()}",
        )
    else:
        stream = open_replay(source.name)
    return stream


def _recording(source: SourceUrl, opening: _Opening) -> Source:
    stream = open_source(source.url, read_set=opening.read_set)
    return PacedReplay(stream, opening.clock.now_ns)


def open_bus(url: str, clock: Any, report: Report = say) -> Bus:
    """The bus of a hand's URL, its sensors not started. Raises UsageError and a DeviceError."""
    source = source_url(url)
    if source.scheme == "virtual":
        hand = _virtual_hand(source, _Opening(clock, report))
        return open_virtual(hand, source.options.bus_hz)()
    if source.scheme not in HANDS:
        raise UsageError(f"{url!r} is not a hand", next_step="holdfast help scan")
    return _bridge(source)()


def _bridge(source: SourceUrl) -> Callable[[], Bus]:
    """A function that opens the bridge, now and again after it was lost."""
    options = source.options
    return lambda: open_bridge(
        source.scheme, source.name, number=options.number, bus_hz=options.bus_hz
    )


def _hand(source: SourceUrl, opening: _Opening) -> Source:
    return _started(_bridge(source), source, opening, opening.to_force)


def _virtual(source: SourceUrl, opening: _Opening) -> Source:
    from holdfast.drivers.virtual.virtual_hand import FORCE_N_PER_UT

    def scene_force(field_ut: FloatArray) -> FloatArray:
        """The calibration of the scenes' sensors."""
        return np.einsum("ij,sj->si", FORCE_N_PER_UT, field_ut)

    hand = _virtual_hand(source, opening)
    bridge = open_virtual(hand, source.options.bus_hz)
    live = _started(bridge, source, opening, opening.to_force or scene_force)
    # truth and camera of a scene count from its start, which is not that of the first sample
    live.began_ns = hand.faults.born_ns
    return live


def _started(
    open_bus: Callable[[], Bus],
    source: SourceUrl,
    opening: _Opening,
    to_force: ToForce | None,
) -> Hand:
    from holdfast.drivers.hand import Hand
    from holdfast.drivers.layout import read_layout

    options = source.options
    chip = driver_of(options.chip, options.averages)
    hand = Hand(
        open_bus,
        read_layout(options.layout, chip.addresses),
        chip=chip,
        now_ns=opening.clock.now_ns,
        say=opening.report,
        pause=lambda seconds: opening.clock.spend(round(1e9 * seconds)),
        to_force=to_force,
    )
    hand.start()
    return hand


def _virtual_hand(source: SourceUrl, opening: _Opening) -> VirtualHand:
    from holdfast.drivers.layout import read_layout
    from holdfast.drivers.virtual.faults import read_fault
    from holdfast.drivers.virtual.virtual_hand import VirtualHand, require_wired

    options = source.options
    emulation = emulation_of(options.chip)
    places = read_layout(options.layout, emulation.addresses)
    # before the scene is simulated, which takes seconds
    require_wired(places, emulation.addresses)
    faults = [read_fault(text) for text in options.fault]
    for fault in faults:
        if (fault.sensor or 0) > len(places):
            what = f"fault={fault.kind}:{fault.sensor}: the layout has {len(places)} sensors"
            raise UsageError(what, next_step=f"name a sensor from 1 to {len(places)}")

    track = opening.field
    if track is None and options.scene:
        from holdfast.live.scene import field_of

        track = field_of(source, opening.report)
    if track is not None and track.n_sensors != len(places):
        raise UsageError(
            f"the layout has {len(places)} sensors, the scene's hand {track.n_sensors} sensors",
            next_step="name a place for each sensor, such as layout=0:35,0:22 for two",
        )
    return VirtualHand(
        opening.clock,
        track=track,
        places=places,
        emulation=emulation,
        seed=options.seed,
        faults=faults,
    )


def _stream(source: SourceUrl, opening: _Opening) -> Source:
    from holdfast.drivers.lsl import LslInlet, LslSource

    if opening.to_force is not None:
        raise UsageError(
            "a calibration is for a hand, not for a stream",
            next_step="send forces, or leave it out",
        )
    options = source.options
    inlet = LslInlet(stream_name(source.name))
    clock, report = opening.clock, opening.report
    hand = None if options.hand is None else read_hand_card(options.hand)
    return LslSource(inlet, clock, report, options.unit, options.rate_hz, hand)


def _lines(source: SourceUrl, opening: _Opening) -> Source:
    from holdfast.drivers.lines import LineSource, SampleReader

    # a file is there as a whole, and lines come as time goes by
    if source.scheme == "stdin" and stat.S_ISREG(os.fstat(0).st_mode):
        raise UsageError(
            f"{source.url}: standard input is a file, which is a recording",
            next_step=f"{REPLAY}FILE (holdfast import reads other columns)",
        )
    options = source.options
    column_map, hand = _column_map(options)
    own_unit: Unit = options.unit or "N"
    unit = column_map.unit_of_values if column_map else own_unit
    if opening.to_force is not None and unit != "uT":
        raise UsageError(
            f"a calibration maps a field in uT to a force, and these lines are in {unit}",
            next_step="leave it out, or say unit=uT",
        )
    if opening.to_force is not None and hand and hand.unmeasured_names:
        raise UsageError(
            f"a calibration needs all three axes, and {hand.name} does not measure "
            f"{', '.join(hand.unmeasured_names)}",
            next_step="send forces",
        )

    rate_hz = options.rate_hz or (column_map.time.rate_hz if column_map else None)
    reader = SampleReader(column_map, own_unit, opening.to_force, hand)
    feed = open_feed(source, "--source", opening.report)
    opening.report(f"{feed.name}: waiting for the first samples")
    clock, report = opening.clock, opening.report
    try:
        return LineSource(feed, reader, clock, report, rate_hz)
    except BaseException:
        feed.close()
        raise


def _column_map(
    options: LinesOptions,
) -> tuple[ColumnMap | None, HandCard | None]:
    """The map and the hand card that the options of lines name."""
    if options.map is None:
        hand = None if options.hand is None else read_hand_card(options.hand)
        return None, hand
    for key in ("unit", "hand"):
        if getattr(options, key) is not None:
            raise UsageError(
                f"{key}= beside a map", next_step=f"write the {key} into the map"
            )
    from holdfast.core.column_map import read_column_map

    try:
        column_map = read_column_map(options.map)
    except FileNotFoundError:
        raise CardError("no such column map", where=options.map) from None
    wrong = too_many(len(column_map.sensors))
    if wrong:
        raise ColumnError(wrong, where=options.map, next_step="map those that matter")
    # looked at here: a map that contradicts its hand card is refused before anything opens
    return column_map, column_map.hand_card(Path(options.map).parent)


def open_feed(source: SourceUrl, option: str, report: Report) -> Feed:
    """What reads the lines of a stdin, unix or serial URL. option: its name for people.

    report: receives what becomes of a serial port. Raises UsageError, DeviceError.
    """
    from holdfast.drivers.line_feeds import DatagramFeed, SerialFeed, stdin_feed

    if source.scheme == "stdin":
        return stdin_feed()
    if not source.name.startswith("/") or source.name == "/":
        raise UsageError(
            f"{option} {source.url[:80]!r} is not an address",
            next_step=f"{source.scheme}:///PATH, with three slashes",
        )
    if source.scheme == "unix":
        return DatagramFeed(source.name)
    return SerialFeed(source.name, source.options.baud, report)


class Scheme(NamedTuple):
    """What may stand behind the ? of its URLs, and what opens one."""

    options: type[NoOptions]
    open: Callable[[SourceUrl, _Opening], Source]


SCHEMES = {
    "usb": Scheme(HandOptions, _hand),
    "i2c": Scheme(HandOptions, _hand),
    "virtual": Scheme(VirtualOptions, _virtual),
    "lsl": Scheme(StreamOptions, _stream),
    "stdin": Scheme(LinesOptions, _lines),
    "unix": Scheme(LinesOptions, _lines),
    "serial": Scheme(SerialOptions, _lines),
    "sim": Scheme(SceneOptions, _recording),
    "replay": Scheme(NoOptions, _recording),
}
