"""URLs of hands that can be read live.

    usb://ft232h?number=0                     a bridge on USB
    i2c://1                                   the board's own bus, /dev/i2c-1
    virtual://ft232h?scene=pull-soft-ball     the same driver on an emulated bridge; seed, trial, and faults
              &fault=nack:3@1.5+0.2           (drivers/virtual/faults.py)
    any other source                          a recording or a scene, at the pace it was recorded at

A hand also takes layout=mux (drivers/layout.py), averages=32, crc=auto (on: a chip without CRC is
refused; off: nothing is checked), burst=1 (shorter reads without CRC) and together=1 (all fingers
convert at one moment, when asked).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import parse_qs

import numpy as np

from drivers.bridges import BRIDGES, open_native, open_usb, open_virtual
from drivers.bus import Bus
from drivers.hand import Crc, Hand
from drivers.layout import read_layout
from drivers.live_hand import LiveHand
from drivers.paced import Paced
from drivers.tmag5273 import Setup
from edge_runtime.contract import FloatArray
from edge_runtime.errors import UsageError
from edge_runtime.live import Source
from holdfast.mistakes import require_meant
from holdfast.sources import MOST_DIGITS, SIM, open_source, simulated_trial, taken_apart

if TYPE_CHECKING:
    from drivers.virtual.hand import VirtualHand
    from simulation.scene import Scene
    from simulation.scene import SimulatedTrial as SimulatedTrial

HANDS = ("usb", "i2c", "virtual")
HAND_KEYS = ("layout", "averages", "crc", "burst", "together", "bus_hz", "number")
CRC_WORDS = ("auto", "on", "off")
VIRTUAL_KEYS = (*HAND_KEYS, "scene", "trial", "seed", "fault")
FIELD_HZ = 1000.0
"""A scene's field is simulated so often for the virtual chips, which convert it at their own
times."""
OF_THE_CHIP = (
    "averaging",
    "hall_noise",
    "saturation",
    "quantisation",
    "timing_jitter",
    "dropped_samples",
    "stale_sensor",
)
"""Effects that the virtual chip and the bus have themselves."""

ToForce = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class SourceUrl:
    """A URL taken apart: scheme, what stands behind it, and its options."""

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
                f"{key}={text[:40]!r} is no whole number", next_step=f"{key}={default}"
            )
        return int(text)


def open_live(
    url: str, *, clock: Any, say: Callable[[str], None], to_force: ToForce | None = None
) -> Source:
    """Open and start a live source. clock: now_ns, spend and wait_until; to_force: a calibration,
    for a hand.

    Raises UsageError for a URL that cannot be, and what the hand or the recording raises.
    """
    told = _taken_apart(url)
    if told.scheme not in HANDS:
        return Paced(open_source(url), clock.now_ns)
    if told.scheme == "virtual":
        _known(told, VIRTUAL_KEYS)
        hand = _virtual(told, clock)
        bus_hz = told.number("bus_hz", 400_000)
        opener = open_virtual(told.name, hand, bus_hz)
        live = _started(opener, told, clock, say, to_force or _scene_force())
        live.began_ns = hand.born_ns
        return live
    return _started(_opener(told, clock), told, clock, say, to_force)


def open_bus(url: str, clock: Any) -> Bus:
    """The bus behind a hand's URL, nothing brought up. Raises UsageError, and what the bridge
    raises."""
    told = _taken_apart(url)
    if told.scheme not in HANDS:
        require_meant(url)
        raise UsageError(f"{url!r} is no hand", next_step=f"{'://.., '.join(HANDS)}://..")
    return _opener(told, clock)()


def named_addresses(url: str) -> frozenset[int]:
    """Where a URL's layout says that its fingers answer. Raises UsageError."""
    layout = read_layout(_taken_apart(url).text("layout", "mux"))
    return frozenset(address for one in layout for address in (one.address, one.read_at))


def _opener(told: SourceUrl, clock: Any) -> Callable[[], Bus]:
    """What opens the bridge, now and after it was lost."""
    _known(told, VIRTUAL_KEYS if told.scheme == "virtual" else HAND_KEYS)
    number, bus_hz = told.number("number", 0), told.number("bus_hz", 400_000)
    if told.scheme == "virtual":
        return open_virtual(told.name, _virtual(told, clock), bus_hz)
    if told.scheme == "usb":
        return lambda: open_usb(told.name, number, bus_hz)
    return lambda: open_native(told.name)


def _taken_apart(url: str) -> SourceUrl:
    parts = taken_apart(url)
    name = parts.netloc + parts.path
    if parts.scheme in ("usb", "virtual") and name not in BRIDGES:
        raise UsageError(f"{url!r}: no bridge {name!r}", next_step=f"one of {', '.join(BRIDGES)}")
    return SourceUrl(parts.scheme, name, parse_qs(parts.query, keep_blank_values=True))


def _known(told: SourceUrl, allowed: tuple[str, ...]) -> None:
    for key in told.options:
        if key not in allowed:
            raise UsageError(
                f"{told.scheme}://: {key!r} is not known",
                next_step=f"allowed: {', '.join(allowed)}",
            )


def _started(
    open_bus: Callable[[], Bus],
    told: SourceUrl,
    clock: Any,
    say: Callable[[str], None],
    to_force: ToForce | None,
) -> LiveHand:
    averages = told.number("averages", 32)
    if averages not in (1, 2, 4, 8, 16, 32):
        raise UsageError(
            f"averages={averages} is not what the chip has", next_step="1, 2, 4, 8, 16 or 32"
        )
    crc = told.text("crc", "auto")
    if crc not in CRC_WORDS:
        raise UsageError(
            f"crc={crc[:40]!r} is not known", next_step=f"crc={' or crc='.join(CRC_WORDS)}"
        )
    hand = Hand(
        open_bus,
        read_layout(told.text("layout", "mux")),
        now_ns=clock.now_ns,
        say=say,
        crc=cast("Crc", crc),
        setup=Setup(
            averages, burst=bool(told.number("burst", 0)), together=bool(told.number("together", 0))
        ),
        pause=lambda seconds: clock.wait_until(clock.now_ns() + round(1e9 * seconds)),
    )
    hand.start()
    return LiveHand(hand, to_force)


def _virtual(told: SourceUrl, clock: Any) -> VirtualHand:
    from drivers.virtual.faults import read_fault
    from drivers.virtual.hand import LAYOUTS, VirtualHand

    layout = told.text("layout", "mux")
    name = layout.partition("@")[0]
    if name not in LAYOUTS:
        raise UsageError(
            "a virtual hand has no such layout", next_step=f"layout={' or layout='.join(LAYOUTS)}"
        )
    seed = told.number("seed", 0)
    hand = VirtualHand(
        clock,
        track=_track(told.text("scene", ""), seed, told.number("trial", 0)),
        layout=name,
        seed=seed,
        faults=[read_fault(text) for text in told.options.get("fault", [])],
    )
    hand.mux.address = read_layout(layout)[0].mux
    return hand


def _track(scene: str, seed: int, trial: int) -> Any:
    """The field of a scene's trial at the chips, or a hand at rest."""
    from drivers.virtual.hand import Track, still

    if not scene:
        return still()
    signal = simulated(scene, seed, trial)[1].signal
    return Track(signal.t_s, signal.values)


def scene_of(url: str) -> tuple[Scene, SimulatedTrial] | None:
    """The scene behind a URL and what happens in it: virtual://..?scene=.., or a single trial of
    sim://; else None."""
    if url.startswith(SIM):
        return simulated_trial(url)
    told = _taken_apart(url)
    if told.scheme != "virtual" or not told.text("scene", ""):
        return None
    return simulated(told.text("scene", ""), told.number("seed", 0), told.number("trial", 0))


@lru_cache(maxsize=1)
def simulated(scene: str, seed: int, trial: int) -> tuple[Scene, SimulatedTrial]:
    """A trial of a card as the chips of a virtual hand meet it. Raises CardError, UsageError."""
    from simulation.card import read_card
    from simulation.scene import Scene

    card = read_card(scene, rate_hz=FIELD_HZ) if Path(scene).is_file() else read_card(scene)
    effects = {name: told for name, told in card.effects.items() if name not in OF_THE_CHIP}
    made = Scene(replace(card, rate_hz=FIELD_HZ, unit="uT", effects={"dipole": {}} | effects), seed)
    trials = made.trials()
    if trial >= len(trials):
        raise UsageError(f"scene {scene}: no trial {trial}", next_step=f"0..{len(trials) - 1}")
    return made, made.run_together([trials[trial]])[0]


def _scene_force() -> ToForce:
    """The calibration of the scenes' sensors, for a virtual hand without one of its own."""
    from simulation.sensor.calibration import linear_map

    matrix = linear_map()[0]
    return lambda field_ut: np.einsum("ij,sj->si", matrix, field_ut)
