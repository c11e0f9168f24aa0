"""Six chips on a wire, behind a mux or re-addressed, in a field that changes with time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.drivers.tmag5273 import FACTORY_ADDRESSES
from holdfast.drivers.virtual.chip import Chip, FieldSource
from holdfast.drivers.virtual.clock import Clock
from holdfast.drivers.virtual.faults import Fault, Faults
from holdfast.drivers.virtual.wire import Mux, Noise, Target, Wire

A, B, C, D = FACTORY_ADDRESSES
WIRINGS: dict[str, tuple[tuple[int, int], ...]] = {
    "mux": ((0, A), (0, B), (0, C), (0, D), (1, A), (1, B)),
    "mux6": ((0, A), (1, A), (2, A), (3, A), (4, A), (5, A)),
    "moved": ((0, A), (0, B), (0, C), (0, D), (1, A), (1, B)),
}
"""Mux channel and factory address of each finger: two shared channels, or one for each finger."""
BIT_ERROR_RATE = 1e-4
"""Of the fault "noise"."""
REST_UT = np.array([0.0, 0.0, 23730.0])
"""The field of a resting magnet."""


@dataclass(frozen=True)
class Track:
    """A recorded or simulated field: t_s [T] from 0, field_ut [T, 6, 3], linear in between.

    Before the first and after the last row, that row holds.
    """

    t_s: FloatArray
    field_ut: FloatArray

    def at(self, now_s: float, sensor: int) -> list[float]:
        """x, y, z of one sensor (0 .. 5).

        Equal to np.interp to the last bit, at a tenth of its time.
        """
        row, last = int(self.t_s.searchsorted(now_s, "right")) - 1, len(self.t_s) - 1
        if row < 0 or row >= last:
            held: list[float] = self.field_ut[min(max(row, 0), last), sensor].tolist()
            return held
        (before, after), (from_s, to_s) = (
            of[row : row + 2].tolist() for of in (self.field_ut[:, sensor], self.t_s)
        )
        return [
            (after_ut - before_ut) / (to_s - from_s) * (now_s - from_s) + before_ut
            for before_ut, after_ut in zip(before, after, strict=True)
        ]


def still(field_ut: FloatArray = REST_UT) -> Track:
    """A field that never changes."""
    return Track(np.array([0.0]), np.broadcast_to(field_ut, (1, 6, 3)))


class VirtualHand:
    """Chips, mux and wire. layout: a name of LAYOUTS; seed: of the chips' noise, None for none.

    born_ns: when the hand was made; its field and its faults begin then.
    """

    def __init__(
        self,
        clock: Clock,
        *,
        track: Track | None = None,
        layout: str = "mux",
        version: int = 1,
        seed: int | None = None,
        faults: Sequence[Fault] = (),
    ) -> None:
        self.clock, self.faults, self.track = clock, Faults(faults), track or still()
        self.born_ns = clock.now_ns()
        self.chips = [
            Chip(
                k + 1,
                address,
                version,
                self._field_of(k),
                clock,
                self.faults,
                seed=seed,
            )
            for k, (_, address) in enumerate(WIRINGS[layout])
        ]
        channels: list[list[Target]] = [[] for _ in range(8)]
        for chip, (channel, _) in zip(self.chips, WIRINGS[layout], strict=True):
            channels[channel].append(chip)
        self.mux = Mux(channels)
        self.wire, self._noise = Wire([self.mux]), Noise(BIT_ERROR_RATE)

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
        now_s = 1e-9 * (self.clock.now_ns() - self.born_ns)
        if self.faults.happened("stuck", now_s):
            self.wire.hold_low()
        self.wire.noise = self._noise if self.faults.lasts("noise", now_s) else None

    def _field_of(self, sensor: int) -> FieldSource:
        return lambda now_s: self.track.at(now_s, sensor)
