"""What opens a source of samples: one table, scheme by scheme (source_url.py has the URLs)."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.contract import FloatArray, Unit
from holdfast.core.errors import CardError, DataNotFound, UnitError, UsageError
from holdfast.core.source import Source
from holdfast.drivers.bridges import open_bus as open_bridge
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.replay import PacedReplay, Replay, open_replay
from holdfast.edge_runtime.preparation import Preparation
from holdfast.live.running import say
from holdfast.live.scene_source import field_of, scene_force, simulated_stream
from holdfast.live.source_url import (
    HANDS,
    REPLAY,
    SIM,
    LineOptions,
    SourceUrl,
    StdinOptions,
    source_url,
    stream_name,
)

if TYPE_CHECKING:
    from holdfast.core.column_map import ColumnMap
    from holdfast.drivers.bus import Bus
    from holdfast.drivers.hand import LiveHand
    from holdfast.drivers.line_feeds import Feed
    from holdfast.drivers.virtual.virtual_hand import VirtualHand

Report = Callable[[str], None]
ToForce = Callable[[FloatArray], FloatArray]
"""Field [sensors, 3] -> force [sensors, 3]."""
SetReader = Callable[[str, int | None], Replay]
"""(SET#N, channels) -> trial N of a labelled set, prepared. Sets are read by packages above."""


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
    return OPENERS[source.scheme](source, opening)


def open_source(
    url: str,
    *,
    channels: int | None = None,
    preparation: Preparation | None = None,
    read_set: SetReader | None = None,
) -> Replay:
    """A recording or trials of a scene, without its bias as in `preparation`.

    read_set: reads SET#N, prepared, with so many channels. Raises a DataError or UsageError.
    """
    source = source_url(url)
    if source.scheme == "sim":
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
            next_step=f"one of {', '.join(f'{scheme}://' for scheme in OPENERS)}",
        )
    else:
        stream = open_replay(source.name)
    return stream if preparation is None else stream.prepared(preparation)


def _recording(source: SourceUrl, opening: _Opening) -> Source:
    stream = open_source(source.url, read_set=opening.read_set)
    return PacedReplay(stream, opening.clock.now_ns)


def open_bus(url: str, clock: Any, report: Report = say) -> Bus:
    """The bus of a hand's URL, its sensors not started. Raises UsageError and a DeviceError."""
    source = source_url(url)
    if source.scheme == "virtual":
        hand = _virtual_hand(source, _Opening(clock, report))
        return open_virtual(source.name, hand, source.options.bus_hz)()
    if source.scheme not in HANDS:
        step = f"{'://.., '.join(HANDS)}://.."
        raise UsageError(f"{url!r} is not a hand", next_step=step)
    return _bridge(source)()


def named_addresses(url: str) -> frozenset[int]:
    """The addresses of the fingers in a URL's layout. Raises UsageError."""
    from holdfast.drivers.layout import read_layout

    addresses: set[int] = set()
    for finger in read_layout(source_url(url).options.layout):
        addresses.update((finger.address, finger.read_at))
    return frozenset(addresses)


def _bridge(source: SourceUrl) -> Callable[[], Bus]:
    """A function that opens the bridge, now and again after it was lost."""
    options = source.options
    return lambda: open_bridge(
        source.scheme, source.name, number=options.number, bus_hz=options.bus_hz
    )


def _hand(source: SourceUrl, opening: _Opening) -> Source:
    return _started(_bridge(source), source, opening, opening.to_force)


def _virtual(source: SourceUrl, opening: _Opening) -> Source:
    hand = _virtual_hand(source, opening)
    bridge = open_virtual(source.name, hand, source.options.bus_hz)
    live = _started(bridge, source, opening, opening.to_force or scene_force())
    # truth and camera of a scene count from its start, which is not that of the first sample
    live.began_ns = hand.born_ns
    return live


def _started(
    open_bus: Callable[[], Bus],
    source: SourceUrl,
    opening: _Opening,
    to_force: ToForce | None,
) -> LiveHand:
    from holdfast.drivers.hand import Hand, LiveHand
    from holdfast.drivers.layout import read_layout
    from holdfast.drivers.tmag5273 import Setup

    clock = opening.clock
    options = source.options

    def pause(seconds: float) -> None:
        clock.wait_until(clock.now_ns() + round(1e9 * seconds))

    hand = Hand(
        open_bus,
        read_layout(options.layout),
        now_ns=clock.now_ns,
        say=opening.report,
        setup=Setup(options.averages, together=options.together),
        pause=pause,
    )
    hand.start()
    return LiveHand(hand, to_force)


def _virtual_hand(source: SourceUrl, opening: _Opening) -> VirtualHand:
    from holdfast.drivers.layout import read_layout
    from holdfast.drivers.virtual.faults import read_fault
    from holdfast.drivers.virtual.virtual_hand import VirtualHand, wiring_of

    options = source.options
    places = read_layout(options.layout)
    # before the scene is simulated, which takes seconds
    wiring = wiring_of(places)
    faults = [read_fault(text) for text in options.fault]
    for fault in faults:
        if (fault.sensor or 0) > len(places):
            what = f"fault={fault.kind}:{fault.sensor}: the layout has {len(places)} sensors"
            raise UsageError(what, next_step=f"name a sensor from 1 to {len(places)}")

    track = opening.field or field_of(source, opening.report)
    if track is not None and track.n_sensors != len(places):
        raise UsageError(
            f"the layout has {len(places)} sensors, the scene's hand {track.n_sensors} sensors",
            next_step="name a place for each sensor, such as layout=0:35,0:22 for two",
        )
    hand = VirtualHand(
        opening.clock, track=track, wiring=wiring, seed=options.seed, faults=faults
    )
    # the emulated multiplexer answers where the URL's layout looks for it
    hand.mux.address = places[0].mux
    return hand


def _stream(source: SourceUrl, opening: _Opening) -> Source:
    from holdfast.drivers.lsl import LslSource
    from holdfast.drivers.lsl_library import LslInlet

    if opening.to_force is not None:
        raise UsageError(
            "a calibration is for a hand, not for a stream",
            next_step="send forces, or leave it out",
        )
    options = source.options
    inlet = LslInlet(stream_name(source.name))
    return LslSource(
        inlet, opening.clock.now_ns, opening.report, options.unit, options.rate_hz
    )


def _lines(source: SourceUrl, opening: _Opening) -> Source:
    from holdfast.drivers import line_source
    from holdfast.drivers.sample_lines import SampleReader

    options = source.options
    column_map = _column_map(options)
    own_unit: Unit = options.unit or "N"
    unit = column_map.unit_of_values if column_map else own_unit
    if opening.to_force is not None and unit != "uT":
        raise UsageError(
            f"a calibration maps a field in uT to a force, and these lines are in {unit}",
            next_step="leave it out, or say unit=uT",
        )

    rate_hz = options.rate_hz or (column_map.time.rate_hz if column_map else None)
    paced = source.scheme == "stdin" and _is_paced(options)
    how = line_source.LineOptions(options.stamps, rate_hz, paced)
    reader = SampleReader(column_map, own_unit)
    with ExitStack() as on_error:
        feed = open_feed(source, "--source")
        on_error.callback(feed.close)
        opening.report(f"{feed.name}: waiting for the first samples")
        clock = opening.clock
        lines = line_source.LineSource(
            feed, reader, clock, opening.report, how, opening.to_force
        )
        on_error.pop_all()
    return lines


def _column_map(options: LineOptions) -> ColumnMap | None:
    if options.map is None:
        return None
    if options.unit is not None:
        raise UsageError("unit= beside a map", next_step="write the unit into the map")
    from holdfast.core.column_map import read_column_map

    try:
        column_map = read_column_map(options.map)
    except FileNotFoundError:
        raise CardError("no such column map", where=options.map) from None
    # looked at here: a map that contradicts its hand card is refused before anything opens
    column_map.hand_card(Path(options.map).parent)
    return column_map


def _is_paced(options: StdinOptions) -> bool:
    # a file is there as a whole, and a pipe is written as time goes by
    is_file = stat.S_ISREG(os.fstat(0).st_mode)
    return is_file if options.paced is None else options.paced


def open_feed(source: SourceUrl, option: str) -> Feed:
    """What reads the lines of a stdin, unix or serial URL. option: its name for people.

    Raises UsageError, DeviceError.
    """
    from holdfast.core.hand_lines import line_url
    from holdfast.drivers.line_feeds import DatagramFeed, serial_feed, stdin_feed

    if source.scheme == "stdin":
        return stdin_feed()
    if not source.name.startswith("/") or source.name == "/":
        raise UsageError(
            f"{option} {source.url[:80]!r} is not an address",
            next_step=f"{source.scheme}:///PATH, with three slashes",
        )
    if source.scheme == "unix":
        return DatagramFeed(line_url(f"unix://{source.name}"))
    return serial_feed(source.name, source.options.baud)


OPENERS: dict[str, Callable[[SourceUrl, _Opening], Source]] = {
    "usb": _hand,
    "i2c": _hand,
    "virtual": _virtual,
    "lsl": _stream,
    "stdin": _lines,
    "unix": _lines,
    "serial": _lines,
    "sim": _recording,
    "replay": _recording,
}
"""Scheme -> what opens it."""


# -- the files of a hand


def force_of(path: Path | None) -> ToForce | None:
    """The map from field to force in a calibration file, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration import read_calibration

    return read_calibration(path).apply


def resting_of(path: Path | None, source: Source) -> FloatArray | None:
    """A bias file [C] that fits the source, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration import read_bias

    bias = read_bias(path)
    # a bias in another unit would be subtracted without any error
    if bias.unit != source.unit or len(bias.values) != source.n_channels:
        raise UnitError(
            f"{len(bias.values)} channels in {bias.unit}, "
            f"the source has {source.n_channels} in {source.unit}",
            where=path,
            cause="measured with another calibration or hand",
            next_step="run holdfast bias again",
        )

    return bias.values
