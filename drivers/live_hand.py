"""A hand as a live source: what the fingers read, in uT or, calibrated, in N."""

from __future__ import annotations

from collections.abc import Callable

from holdfast.drivers.hand import Hand
from holdfast.edge_runtime.contract import FloatArray, Unit
from holdfast.edge_runtime.live import SourceReading


class LiveHand:
    """A started hand. to_force.

    field [S, 3] in uT -> force [S, 3] in N, or None to read the field.
    """

    def __init__(
        self, hand: Hand, to_force: Callable[[FloatArray], FloatArray] | None = None
    ) -> None:
        self._hand, self._to_force = hand, to_force
        self.unit: Unit = "uT" if to_force is None else "N"
        self.n_channels = 3 * len(hand.fingers)
        self.rate_hz: float | None = None
        self.began_ns: int | None = None
        """Of a virtual hand: when its scene began."""

    def read(self) -> SourceReading:
        """One scan."""
        reading = self._hand.read()
        values = reading.field_ut if self._to_force is None else self._to_force(reading.field_ut)
        whole = values.reshape(-1)
        return SourceReading(reading.t_ns, whole, reading.valid, reading.why, reading.number)

    def about(self) -> dict[str, object]:
        """What is known of the hand itself."""
        return self._hand.about()

    def close(self) -> None:
        """Give the bridge back."""
        self._hand.close()
