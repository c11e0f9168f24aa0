"""Chips on an I2C wire, behind a mux or re-addressed, in a field that changes with time.

A bridge calls start, write, read and stop; everything on the wire receives all of it. Bits are
counted, because they take time. While SDA is held low, nothing is acknowledged and every byte reads
0.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Protocol

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import UsageError
from holdfast.drivers.chips import DEFAULT_CHIP, emulation_of
from holdfast.drivers.layout import LAYOUTS, Finger, read_layout
from holdfast.drivers.virtual.faults import Clock, Fault, Faults

FieldSource = Callable[[float], Sequence[float]]
"""Time in s -> the field at the chip, [3] in uT."""
BITS_OF_A_BYTE = 9
RELEASED = 0xFF
"""What is read where nothing pulls SDA low."""
CLOCKS_TO_FREE = 9
BIT_ERROR_RATE = 1e-4
"""Of the fault "noise"."""
REST_UT = np.array([0.0, 0.0, 23730.0])
"""The field of a resting magnet."""
FORCE_N_PER_UT = np.diag(
    [5.476783541909617e-4, 5.476783541909616e-4, 9.877272411937602e-4]
)
"""The calibration of these sensors: the linear map that the simulation's magnet is fitted with."""
NOISE_ROWS = 4096


# -- what is on a wire


class Target(Protocol):
    """Something with an address on a wire."""

    @abstractmethod
    def addressed(self, address: int, *, read: bool) -> bool:
        """After a START: whether it acknowledges."""
        ...

    @abstractmethod
    def write(self, byte: int) -> bool:
        """A byte from the master: whether it acknowledges."""
        ...

    @abstractmethod
    def read(self) -> int:
        """The next byte for the master."""
        ...

    @abstractmethod
    def stop(self) -> None:
        """The end of a transfer."""
        ...


class EmulatedChip(Target):
    """A chip in a field that changes with time: what every kind of chip does alike.

    A kind adds what it does on the wire, and its faults `wrong`, `frozen` and `diag`, each in its
    own way (`_has` says when). addresses: of its kind. noise_ut: of one conversion, or one average,
    in x, y, z. number: 1 .. 6, its name in faults; seed: of its noise, None for none.
    """

    addresses: ClassVar[tuple[int, ...]]
    noise_ut: ClassVar[tuple[float, float, float]]

    def __init__(
        self,
        number: int,
        address: int,
        field: FieldSource,
        clock: Clock,
        faults: Faults,
        *,
        seed: int | None = None,
    ) -> None:
        self.number = number
        self.address = address
        self._field = field
        self._clock = clock
        self._faults = faults
        self._noise = noise_of(seed, number, self.noise_ut)
        self.power_on()

    @abstractmethod
    def power_on(self) -> None:
        """Every state as after power-up."""
        ...

    @abstractmethod
    def fall_asleep(self) -> None:
        """It stops to convert, as after a stray write."""
        ...

    def _hears(self, address: int) -> bool:
        """Whether it is called, after the faults that happen once; every `addressed` asks first."""
        if self._faults:
            if self._faults.happened("por", self.number):
                self.power_on()
            if self._faults.happened("sleep", self.number):
                self.fall_asleep()
        return address == self.address and not self._has("nack")

    def _has(self, fault: str) -> bool:
        """Whether this chip has a fault now."""
        if not self._faults:
            return False
        return self._faults.lasts(fault, self.number)

    def _completed(self, started_ns: int, duration_s: float) -> int:
        """How many conversions of this duration are complete, one after the other since a start."""
        passed_ns = self._clock.now_ns() - started_ns
        return passed_ns // round(1e9 * duration_s)

    def _measured_ut(
        self, started_ns: int, done: int, duration_s: float, averages: int, row: int
    ) -> list[float]:
        """[3] what the last of `done` conversions measures. row: of the noise, any number."""
        began_s = 1e-9 * (started_ns - self._faults.born_ns)
        # a conversion measures the mean field, which is about that of its middle
        field_ut = self._field(began_s + done * duration_s - 0.5 * duration_s)
        noise_ut = self._noise[row % len(self._noise)]
        root = math.sqrt(averages)
        # plain numbers, faster here than an array
        both = zip(field_ut, noise_ut, strict=True)
        return [field + noise / root for field, noise in both]


@lru_cache(maxsize=12)
def noise_of(
    seed: int | None, number: int, noise_ut: tuple[float, float, float]
) -> tuple[tuple[float, ...], ...]:
    """[rows][3] noise in uT that a chip's conversions use in turn; none without a seed.

    noise_ut: of x, y, z in one conversion. Cached, because hands are opened again and again.
    """
    if seed is None:
        return ((0.0, 0.0, 0.0),)
    random = np.random.default_rng([seed, number])
    noise = random.normal(size=(NOISE_ROWS, 3)) * np.array(noise_ut)
    return tuple(map(tuple, noise.tolist()))


# -- the wire


class Noise:
    """Bits that flip on their way, each with the same probability, always the same ones."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(0)
        self._until = int(self._random.geometric(BIT_ERROR_RATE))

    def flips(self) -> int:
        """Which bits of the next byte flip: a mask of nine bits, the acknowledge lowest."""
        mask = 0
        while self._until <= BITS_OF_A_BYTE:
            mask |= 1 << BITS_OF_A_BYTE - self._until
            self._until += int(self._random.geometric(BIT_ERROR_RATE))
        self._until -= BITS_OF_A_BYTE
        return mask


class Wire:
    """A wire and the targets on it. noise: what flips bits, or None."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self.targets = list(targets)
        self.bits = 0
        self.noise: Noise | None = None
        self._listening: list[Target] = []
        self._address_next = False
        self._reading = self._silent = False
        self._clocks_to_go = 0

    @property
    def held_low(self) -> bool:
        """Whether a chip holds SDA low."""
        return self._clocks_to_go > 0

    def hold_low(self) -> None:
        """A chip was interrupted in a byte and holds SDA until enough clocks have come."""
        self._clocks_to_go = CLOCKS_TO_FREE

    def power_on(self) -> None:
        """A chip that held SDA low has lost its power meanwhile."""
        self._clocks_to_go = 0

    def clock(self) -> None:
        """One clock pulse with SDA released."""
        self.bits += 1
        self._clocks_to_go = max(0, self._clocks_to_go - 1)

    def start(self) -> None:
        """START, or a repeated START."""
        self.bits += 1
        self._address_next = True
        self._listening = []
        self._reading = self._silent = False

    def write(self, byte: int) -> bool:
        """A byte to the addressed targets; whether one acknowledged."""
        self.bits += BITS_OF_A_BYTE
        if self.held_low:
            return False
        if self.noise is None:
            return self._written(byte)
        flips = self.noise.flips()
        return self._written(byte ^ flips >> 1) ^ bool(flips & 1)

    def read(self) -> int:
        """A byte from the addressed targets: open drain, so zeros win; 0xFF without any target."""
        self.bits += BITS_OF_A_BYTE
        if self.held_low:
            return 0
        if self.noise is None:
            return self._sent_byte()
        flips = self.noise.flips()
        byte = self._sent_byte()
        # a target that sees no acknowledge ends
        self._silent = self._silent or bool(flips & 1)
        return byte ^ flips >> 1

    def refuse(self) -> None:
        """The master does not acknowledge a byte: the targets send no more of them."""
        self._silent = True

    def _written(self, byte: int) -> bool:
        if self._address_next:
            self._address_next = False
            self._reading = bool(byte & 1)
            self._listening = _called(self.targets, byte >> 1, self._reading)
            return bool(self._listening)
        if self._reading:  # the targets send the data themselves
            return False
        return _write_all(self._listening, byte)

    def _sent_byte(self) -> int:
        # the targets were addressed for a write: to them the released line is a byte
        if not self._reading:
            _write_all(self._listening, RELEASED)
            return RELEASED
        return RELEASED if self._silent else _read_all(self._listening)

    def stop(self) -> None:
        self.bits += 1
        self._listening = []
        self._address_next = False
        self._reading = False
        for target in self.targets:
            target.stop()


def _called(targets: Sequence[Target], address: int, read: bool) -> list[Target]:
    """The targets that acknowledge this address; every target sees it."""
    return [target for target in targets if target.addressed(address, read=read)]


def _write_all(targets: Sequence[Target], byte: int) -> bool:
    """Whether one of them acknowledged; every target gets the byte."""
    acked = False
    for target in targets:
        # every target gets the byte, also after the first acknowledge
        acked = target.write(byte) or acked
    return acked


def _read_all(targets: Sequence[Target]) -> int:
    byte = RELEASED
    for target in targets:
        # open drain: a zero of any chip wins
        byte &= target.read()
    return byte


class Mux:
    """A TCA9548A: one byte enables any of eight channels, from the next STOP on."""

    def __init__(
        self, channels: Sequence[Sequence[Target]], address: int = 0x70
    ) -> None:
        self.channels = [list(channel) for channel in channels]
        self.address = address
        self._own = False
        self._listening: list[Target] = []
        self.power_on()

    def addressed(self, address: int, *, read: bool) -> bool:
        """Its own address, or one on an enabled channel."""
        self._own = address == self.address
        self._listening = [] if self._own else _called(self._enabled, address, read)
        return self._own or bool(self._listening)

    def write(self, byte: int) -> bool:
        """To its control register, or on to the channels."""
        if self._own:
            self._next = byte
            return True
        return _write_all(self._listening, byte)

    def read(self) -> int:
        """Its control register, or what the channels send."""
        return self.control if self._own else _read_all(self._listening)

    def stop(self) -> None:
        """The new channels are enabled; the channels used so far receive the STOP."""
        for target in self._enabled:
            target.stop()
        # a TCA9548A switches at the STOP, not at the byte
        if self._next != self.control:
            self._enable(self._next)
        self._own = False
        self._listening = []

    def power_on(self) -> None:
        """After power-up no channel is enabled."""
        self._enable(0)

    def _enable(self, control: int) -> None:
        self.control = self._next = control
        self._enabled: list[Target] = []
        for number, channel in enumerate(self.channels):
            if control >> number & 1:
                self._enabled += channel


@dataclass(frozen=True)
class Track:
    """A recorded or simulated field: t_s [T] from 0, field_ut [T, S, 3], linear in between.

    Before the first and after the last row, that row holds.
    """

    t_s: FloatArray
    field_ut: FloatArray

    @property
    def n_sensors(self) -> int:
        return len(self.field_ut[0])

    def at(self, now_s: float, sensor: int) -> list[float]:
        """x, y, z of one sensor (0 .. S - 1).

        Equal to np.interp to the last bit, at a tenth of its time. The arrays are read anew at each
        call: a scene that goes on while it is read writes into them.
        """
        row = int(self.t_s.searchsorted(now_s, "right")) - 1
        last = len(self.t_s) - 1
        if row < 0 or row >= last:
            held: list[float] = self.field_ut[min(max(row, 0), last), sensor].tolist()
            return held
        before, after = self.field_ut[row : row + 2, sensor].tolist()
        from_s, to_s = self.t_s[row : row + 2].tolist()
        field_ut = []
        for before_ut, after_ut in zip(before, after, strict=True):
            # the order of these operations is np.interp's, for equal bits
            slope = (after_ut - before_ut) / (to_s - from_s)
            field_ut.append(slope * (now_s - from_s) + before_ut)

        return field_ut


def still(field_ut: FloatArray = REST_UT, sensors: int = 6) -> Track:
    """A field that never changes."""
    return Track(np.array([0.0]), np.broadcast_to(field_ut, (1, sensors, 3)))


def require_wired(places: Sequence[Finger], addresses: Sequence[int]) -> None:
    """Raise UsageError for a layout on which no virtual hand has its sensors.

    addresses: the factory addresses of its chips.
    """
    for one in places:
        same_mux = one.mux == places[0].mux
        if one.channel is None or not same_mux or one.address not in addresses:
            example = f"layout=0:{addresses[0]:02x},0:{addresses[1]:02x}"
            raise UsageError(
                "a virtual hand has no such layout",
                cause="its sensors are behind one mux, each at a factory address",
                next_step=f"layout={' or layout='.join(LAYOUTS)}, or channel:address for "
                f"each sensor, such as {example}",
            )


class VirtualHand:
    """Chips, mux and wire. places: of the fingers; seed: of the chips' noise, None for none.

    emulation: of the kind of chip.

    Raises UsageError for places that are not behind one mux.
    """

    def __init__(
        self,
        clock: Clock,
        *,
        track: Track | None = None,
        places: Sequence[Finger] | None = None,
        emulation: type[EmulatedChip] | None = None,
        seed: int | None = None,
        faults: Sequence[Fault] = (),
    ) -> None:
        emulation = emulation or emulation_of(DEFAULT_CHIP)
        places = places or read_layout("mux", emulation.addresses)
        require_wired(places, emulation.addresses)
        for fault in faults:
            if fault.sensor is not None and fault.sensor > len(places):
                raise UsageError(
                    f"a fault of sensor {fault.sensor}, and the hand has {len(places)}",
                    next_step=f"{fault.kind}:{len(places)}@{fault.at_s:g}",
                )
        self.clock = clock
        self.faults = Faults(clock, faults)
        self.generation = 0
        """How often its bridge has been unplugged."""
        self._gone = False
        self.track = track or still(sensors=len(places))
        self.chips: list[EmulatedChip] = []
        channels: list[list[Target]] = [[] for _ in range(8)]
        for k, place in enumerate(places):
            field = self._field_of(k)
            chip = emulation(k + 1, place.address, field, clock, self.faults, seed=seed)
            self.chips.append(chip)
            channels[place.channel or 0].append(chip)

        self.mux = Mux(channels, places[0].mux)
        self.wire = Wire([self.mux])
        self._noise = Noise()

    def power_off(self) -> None:
        """The power goes and comes back: everything on the wire starts again."""
        self.mux.power_on()
        self.wire.power_on()
        for chip in self.chips:
            chip.power_on()

    def suffer(self) -> None:
        """Apply the faults of the bus; a bridge calls it before it uses the wire."""
        if not self.faults:
            return
        if self.faults.happened("stuck"):
            self.wire.hold_low()
        self.wire.noise = self._noise if self.faults.lasts("noise") else None

    def unplugged(self) -> bool:
        """Whether its bridge is away; the sensors get their power from it."""
        gone = self.faults.lasts("unplug")
        if gone and not self._gone:
            self.generation += 1
            self.power_off()
        self._gone = gone
        return gone

    def _field_of(self, sensor: int) -> FieldSource:
        return lambda now_s: self.track.at(now_s, sensor)
