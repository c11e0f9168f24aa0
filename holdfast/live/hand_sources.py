"""URLs of hands that can be read live.

    usb://ft232h?number=0                     a bridge on USB
    i2c://1                                   the board's own bus, /dev/i2c-1
    virtual://ft232h?scene=pull-soft-ball     the same driver on an emulated bridge; also seed,
              &fault=nack:3@1.5+0.2           trial, and faults (drivers/virtual/virtual_hand.py)
    lsl://NAME?unit=N                         a stream of the lab streaming layer (extra `lsl`);
              unit and rate_hz where the stream does not say them
    -, tcp://, udp://, serial://, unix://     lines of any program (holdfast/live/line_sources.py)
    any other source                          a recording or a scene, at its own pace

A hand has more options: layout=mux (drivers/layout.py), averages=32 and together=1 (a trigger makes
all fingers convert at one moment).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, unquote

import numpy as np

from holdfast.core.contract import UNITS
from holdfast.core.errors import UsageError
from holdfast.core.source import Source
from holdfast.drivers.bridges import BRIDGES, open_virtual
from holdfast.drivers.bridges import open_bus as open_bridge
from holdfast.drivers.bus import Bus
from holdfast.drivers.hand import Hand, LiveHand
from holdfast.drivers.layout import read_layout
from holdfast.drivers.replay import PacedReplay
from holdfast.drivers.tmag5273 import Setup
from holdfast.live.running import progress_of, say
from holdfast.live.sources import (
    LINES,
    MOST_DIGITS,
    SIM,
    STANDARD_INPUT,
    SetReader,
    ToForce,
    open_source,
    require_meant,
    simulated_scene,
    simulated_trial,
    split_url,
)

if TYPE_CHECKING:
    from holdfast.drivers.virtual.virtual_hand import VirtualHand
    from holdfast.simulation.protocol import PlannedTrial
    from holdfast.simulation.scene import Scene, SimulatedTrial

HANDS = ("usb", "i2c", "virtual")
LSL = "lsl"
LSL_KEYS = ("unit", "rate_hz")
HAND_KEYS = (
    "layout",
    "averages",
    "together",
    "bus_hz",
    "number",
)
VIRTUAL_KEYS = (*HAND_KEYS, "scene", "trial", "seed", "fault")
FIELD_HZ = 1000.0
"""Rate of a scene's field for the virtual chips, each of which converts it at its time."""


@dataclass(frozen=True)
class SourceUrl:
    """A URL in parts: scheme, name, and options."""

    scheme: str
    name: str
    options: dict[str, list[str]]

    def text(self, key: str, default: str) -> str:
        """The last value of an option."""
        return self.options.get(key, [default])[-1]

    def number(self, key: str, default: int) -> int:
        """The same, a whole number. Raises UsageError."""
        text = self.text(key, str(default))
        if not text.isdecimal() or len(text) > MOST_DIGITS:
            raise UsageError(
                f"{key}={text[:40]!r} is not a whole number",
                next_step=f"{key}={default}",
            )
        return int(text)


def open_live(
    url: str,
    *,
    clock: Any,
    report: Callable[[str], None],
    to_force: ToForce | None = None,
    field: Any = None,
    read_set: SetReader | None = None,
) -> Source:
    """Open and start a live source.

    clock: has now_ns, spend and wait_until; to_force: a calibration, for a hand; field: what a
    virtual hand's chips measure, in place of the recorded field of its scene; read_set: reads
    SET#N. Raises UsageError for an impossible URL, and the errors of the hand or the recording.
    """
    if is_lines(url):
        from holdfast.live.line_sources import open_lines

        return open_lines(url, clock, report, to_force)
    source = _source_url(url)
    # a stream sends by itself: it has no bridge and needs no schedule on a bus
    if source.scheme == LSL:
        return _stream(source, clock, report, to_force)
    if source.scheme not in HANDS:
        recording = open_source(url, read_set=read_set)
        return PacedReplay(recording, clock.now_ns)

    if source.scheme != "virtual":
        bridge = _opener(source, clock, report)
        return _started(bridge, source, clock, report, to_force)

    # refused before the scene is simulated, which takes seconds
    _require_known(source, VIRTUAL_KEYS)
    hand = _virtual(source, clock, report, field)
    bridge = open_virtual(source.name, hand, source.number("bus_hz", 400_000))
    live = _started(bridge, source, clock, report, to_force or _scene_force())
    # truth and camera of a scene count from its start, which is not that of the first sample
    live.began_ns = hand.born_ns
    return live


def is_lines(url: str) -> bool:
    """Whether a URL stands for lines of another program."""
    # udp:HOST:PORT, without the slashes, gets a suggestion like other sources
    named = "://" in url and split_url(url).scheme in LINES
    return url == STANDARD_INPUT or named


def is_hand(url: str) -> bool:
    """Whether a URL is a hand or a stream, which has no end of its own, unlike a recording."""
    return is_lines(url) or split_url(url).scheme in (*HANDS, LSL)


def _stream(
    source: SourceUrl,
    clock: Any,
    report: Callable[[str], None],
    to_force: ToForce | None,
) -> Source:
    _require_known(source, LSL_KEYS)
    word = source.text("unit", "")
    unit = next((known for known in UNITS if known == word), None)
    name = unquote(source.name)
    if word and unit is None:
        units = "|".join(UNITS)
        raise UsageError(f"unit={word[:40]!r} is not known", next_step=f"unit={units}")

    # liblsl finds a stream by a query in which the name stands between quotes
    if not name or "'" in name:
        raise UsageError(
            f"{name[:40]!r} is no name of a stream", next_step="lsl://NAME"
        )

    if to_force is not None:
        raise UsageError(
            "--calibration is for a hand, not for a stream",
            next_step="send forces, or leave it out",
        )

    from holdfast.drivers.lsl import LslSource
    from holdfast.drivers.lsl_library import LslInlet

    rate_hz = source.number("rate_hz", 0) or None
    return LslSource(LslInlet(name), clock.now_ns, report, unit, rate_hz)


def open_bus(url: str, clock: Any, report: Callable[[str], None] = say) -> Bus:
    """The bus of a hand's URL, its sensors not started. Raises UsageError and a DeviceError."""
    source = _source_url(url)
    if source.scheme not in HANDS:
        require_meant(url)
        raise UsageError(
            f"{url!r} is not a hand", next_step=f"{'://.., '.join(HANDS)}://.."
        )
    return _opener(source, clock, report)()


def named_addresses(url: str) -> frozenset[int]:
    """The addresses of the fingers in a URL's layout. Raises UsageError."""
    addresses: set[int] = set()
    for finger in read_layout(_source_url(url).text("layout", "mux")):
        addresses.update((finger.address, finger.read_at))
    return frozenset(addresses)


def _opener(
    source: SourceUrl, clock: Any, report: Callable[[str], None]
) -> Callable[[], Bus]:
    """A function that opens the bridge, now and again after it was lost."""
    is_virtual = source.scheme == "virtual"
    _require_known(source, VIRTUAL_KEYS if is_virtual else HAND_KEYS)

    number = source.number("number", 0)
    bus_hz = source.number("bus_hz", 400_000)
    if is_virtual:
        hand = _virtual(source, clock, report)
        return open_virtual(source.name, hand, bus_hz)

    scheme = source.scheme
    name = source.name
    return lambda: open_bridge(scheme, name, number=number, bus_hz=bus_hz)


def _source_url(url: str) -> SourceUrl:
    parts = split_url(url)
    name = parts.netloc + parts.path
    if parts.scheme in ("usb", "virtual") and name not in BRIDGES:
        raise UsageError(
            f"{url!r}: no bridge {name!r}", next_step=f"one of {', '.join(BRIDGES)}"
        )

    return SourceUrl(parts.scheme, name, parse_qs(parts.query, keep_blank_values=True))


def _require_known(source: SourceUrl, allowed: tuple[str, ...]) -> None:
    for key in source.options:
        if key not in allowed:
            raise UsageError(
                f"{source.scheme}://: {key!r} is not known",
                next_step=f"allowed: {', '.join(allowed)}",
            )


def _started(
    open_bus: Callable[[], Bus],
    source: SourceUrl,
    clock: Any,
    report: Callable[[str], None],
    to_force: ToForce | None,
) -> LiveHand:
    averages = source.number("averages", 32)
    # the chip averages 2^0 to 2^5 conversions, and its register has no other values
    if averages not in (1, 2, 4, 8, 16, 32):
        raise UsageError(
            f"averages={averages}: the chip does not have it",
            next_step="1, 2, 4, 8, 16 or 32",
        )

    def pause(seconds: float) -> None:
        clock.wait_until(clock.now_ns() + round(1e9 * seconds))

    together = bool(source.number("together", 0))
    hand = Hand(
        open_bus,
        read_layout(source.text("layout", "mux")),
        now_ns=clock.now_ns,
        say=report,
        setup=Setup(averages, together=together),
        pause=pause,
    )
    hand.start()
    return LiveHand(hand, to_force)


def _virtual(
    source: SourceUrl, clock: Any, report: Callable[[str], None], field: Any = None
) -> VirtualHand:
    from holdfast.drivers.virtual.faults import read_fault
    from holdfast.drivers.virtual.virtual_hand import VirtualHand, wiring_of

    places = read_layout(source.text("layout", "mux"))
    wiring = wiring_of(places)
    seed = source.number("seed", 0)
    trial = source.number("trial", 0)
    track = field or _track(source.text("scene", ""), seed, trial, report)
    if track is not None and track.n_sensors != len(places):
        raise UsageError(
            f"the layout has {len(places)} sensors, the scene's hand {track.n_sensors} sensors",
            next_step="name a place for each sensor, such as layout=0:35,0:22 for two",
        )

    faults = [read_fault(text) for text in source.options.get("fault", [])]
    for fault in faults:
        if (fault.sensor or 0) > len(places):
            what = f"fault={fault.kind}:{fault.sensor}: the layout has {len(places)} sensors"
            raise UsageError(what, next_step=f"name a sensor from 1 to {len(places)}")

    hand = VirtualHand(clock, track=track, wiring=wiring, seed=seed, faults=faults)
    # the emulated multiplexer answers where the URL's layout looks for it
    hand.mux.address = places[0].mux
    return hand


def _track(scene: str, seed: int, trial: int, report: Callable[[str], None]) -> Any:
    """The field of a scene's trial at the chips; None where there is no scene."""
    from holdfast.drivers.virtual.virtual_hand import Track

    if not scene:
        return None
    _, one = simulated(scene, seed, trial, report)
    signal = one.signal
    return Track(signal.t_s, signal.values)


def scene_of(url: str) -> tuple[Scene, SimulatedTrial] | None:
    """The scene and the trial of a virtual:// URL with a scene, or of sim://; else None."""
    if url.startswith(SIM):
        return simulated_trial(url)
    named = _named_trial(_source_url(url))
    return None if named is None else simulated(*named)


def _named_trial(source: SourceUrl) -> tuple[str, int, int] | None:
    """(scene, seed, trial) of a virtual:// URL; None where it has no scene."""
    scene = source.text("scene", "")
    if source.scheme != "virtual" or not scene:
        return None
    return scene, source.number("seed", 0), source.number("trial", 0)


_kept: dict[tuple[str, int, int], tuple[Scene, SimulatedTrial]] = {}
"""The newest simulated trial, which several callers need."""


def simulated(
    scene: str, seed: int, trial: int, report: Callable[[str], None] = say
) -> tuple[Scene, SimulatedTrial]:
    """A trial of a card as field at the chips of a virtual hand. Raises CardError, UsageError.

    It takes seconds, so `report` gets the progress.
    """
    key = scene, seed, trial
    if key not in _kept:
        made, planned = _planned(scene, seed, trial)
        progress = progress_of(f"simulating scene {scene}", report)
        one = made.run_together([planned], progress)[0]
        # one trial is enough for a run, and a long one is large
        _kept.clear()
        _kept[key] = made, one

    return _kept[key]


def planned_scene(
    url: str, rate_hz: float, step_s: float
) -> tuple[Scene, PlannedTrial] | None:
    """(scene, trial before it is simulated) of a virtual:// URL; None where it has no scene.

    rate_hz: of the field at the chips. Raises CardError, UsageError.
    """
    named = _named_trial(_source_url(url))
    return None if named is None else _planned(*named, rate_hz, step_s)


def _planned(
    name: str,
    seed: int,
    number: int,
    rate_hz: float = FIELD_HZ,
    step_s: float | None = None,
) -> tuple[Scene, PlannedTrial]:
    made = _scene_at_chips(name, seed, rate_hz, step_s)
    trials = made.trials()
    # numbers in URLs count from 0
    if number >= len(trials):
        what = f"scene {name}: no trial {number}"
        raise UsageError(what, next_step=f"0..{len(trials) - 1}")
    return made, trials[number]


def _scene_at_chips(
    name: str, seed: int, rate_hz: float, step_s: float | None
) -> Scene:
    """The scene in uT without the effects of the virtual chip and bus, and without a controller."""
    from holdfast.simulation.effect import EFFECT_MODULES
    from holdfast.simulation.scene import Scene
    from holdfast.simulation.scene_file import read_scene_file

    file_rate_hz = rate_hz if Path(name).is_file() else None
    card = read_scene_file(name, rate_hz=file_rate_hz)

    # the virtual chip adds its own noise and quantisation, which must not count twice
    effects: dict[str, dict[str, float]] = {"dipole": {}}
    for effect, values in card.effects.items():
        if EFFECT_MODULES[effect] != "chip":
            effects[effect] = values

    field = replace(card, rate_hz=rate_hz, unit="uT", effects=effects)
    if step_s is not None:
        field = replace(field, step_s=step_s)
    return Scene(field, seed)


def shear_gain_of(url: str, calibration: Path | None) -> float | None:
    """Ratio of shear and normal force as read, over the true one; None where not measured.

    Of the calibration, else of the sensors that a scene emulates. Raises a DataError.
    """
    if calibration is not None:
        from holdfast.drivers.calibration import read_calibration

        return read_calibration(calibration).shear_gain

    if split_url(url).scheme == "virtual":
        from holdfast.simulation.magnet import shear_gain

        return shear_gain()
    if not url.startswith(SIM):
        return None
    from holdfast.simulation.magnet import shear_gain_in

    return shear_gain_in(simulated_scene(url).file.effects)


def _scene_force() -> ToForce:
    """The calibration of the scenes' sensors, for a virtual hand without a calibration."""
    from holdfast.drivers.virtual.virtual_hand import FORCE_N_PER_UT

    return lambda field_ut: np.einsum("ij,sj->si", FORCE_N_PER_UT, field_ut)
