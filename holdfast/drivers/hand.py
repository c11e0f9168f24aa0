"""Six fingertips on a bus that is opened, read in one scan, and repaired when something fails.

A failure costs only the readings that it affects, and it is repaired while the other fingers are
read on (the recovery ladder):

    a finger      does not acknowledge twice in a row, or lost its power: the driver brings it up
                  again (holdfast/drivers/fingers.py)
    the bus       is held low: the driver sends nine clocks
    the bridge    fails three times in a row: the driver opens it again
                  is gone from USB, or another program has it: the driver looks for it until it is
                  back

It is a live source: what the fingers read, in uT or, calibrated, in N.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.contract import FloatArray, Unit
from holdfast.core.errors import BusStuck, DeviceError, TransferFailed
from holdfast.core.source import SourceReading
from holdfast.drivers.bus import Bus, freeing
from holdfast.drivers.chips import DEFAULT_CHIP, ChipDriver, driver_of
from holdfast.drivers.fingers import TRY_AGAIN_NS, Fingers
from holdfast.drivers.layout import Finger

FAILURES_TO_REOPEN = 3


class Hand:
    """Fingers behind a bridge that open_bus opens, as a live source.

    chip: the driver of the kind of chip. now_ns, pause (s): the clock. say: receives one line for
    each failure and each recovery.
    to_force: from a field [S, 3] in uT to a force [S, 3] in N, or None to read the field.

    start raises what keeps every finger from being read. After that nothing is raised: each reading
    says what is wrong.
    """

    def __init__(
        self,
        open_bus: Callable[[], Bus],
        fingers: Sequence[Finger],
        *,
        chip: ChipDriver | None = None,
        now_ns: Callable[[], int],
        pause: Callable[[float], None],
        say: Callable[[str], None] = lambda line: None,
        to_force: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.unit: Unit = "uT" if to_force is None else "N"
        self.n_channels = 3 * len(fingers)
        self.rate_hz: float | None = None
        self.began_ns: int | None = None
        """Of a virtual hand: when its scene began."""
        self._to_force = to_force
        self.fingers = tuple(fingers)
        self.chip = chip or driver_of(DEFAULT_CHIP)
        self._open_bus = open_bus
        self._now_ns = now_ns
        self._say = say
        self._driven = Fingers(
            self.fingers, self.chip, now_ns=now_ns, pause=pause, say=say
        )
        self._bus: Bus | None = None
        self._failures = 0
        self._look_at_ns = 0
        self._complaint = ""
        self._last_why = tuple("" for _ in self.fingers)

    def start(self) -> None:
        """Open the bridge and bring up every finger that answers; free a bus that is held low.

        Raises a DeviceError and closes the bridge: what the bridge raises, DeviceNotFound where no
        finger or no mux answers, WrongDevice for another chip.
        """
        try:
            bus = self._bus = self._open_bus()
            freeing(bus, lambda: self._driven.start(bus))
            freeing(bus, lambda: self._driven.settle(bus))
        except BaseException:
            self.close()
            raise

    def read(self) -> SourceReading:
        """One scan. What fails is in the reading, and its repair has begun."""
        t_ns = self._now_ns()
        bus = self._bus or self._look_for_bridge(t_ns)
        if bus is None:
            return self._no_reading(t_ns, "lost")
        try:
            replies = self._driven.scan(bus)
        except BusStuck as error:
            # nine clocks; where they do not help, the bridge is closed and opened again
            self._complain(error)
            try:
                bus.clear()
            except DeviceError as worse:
                return self._give_up(t_ns, worse)
            return self._no_reading(t_ns, "stuck")
        except TransferFailed as error:
            # single failures happen on any USB; a row of them does not heal by itself
            self._failures += 1
            if self._failures >= FAILURES_TO_REOPEN:
                return self._give_up(t_ns, error)
            return self._no_reading(t_ns, "bridge")
        except DeviceError as error:  # gone, or taken by another program
            return self._give_up(t_ns, error)

        self._failures = 0
        self._complaint = ""
        reading = self._driven.judge(t_ns, replies)
        # after the judgement, so that a repair never delays this reading's time
        self._driven.repair(bus, reading)
        self._report_changes(reading.why)
        if self._to_force is None:
            return reading
        force_n = self._to_force(reading.values.reshape(-1, 3))
        return replace(reading, values=force_n.reshape(-1))

    def about(self) -> dict[str, object]:
        """What is known of the hand: its bridge, its fingers, and how they convert.

        firmware is None because the bridges do not report their firmware.
        """
        return {
            "bridge": None if self._bus is None else self._bus.name,
            "firmware": None,
            "chip": self.chip.name,
            "averages": self.chip.averages,
            "sensors": self._driven.about(),
        }

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    # -- the recovery ladder

    def _give_up(self, t_ns: int, error: DeviceError) -> SourceReading:
        """Close the bridge; the next readings look for it."""
        self._complain(error)
        self.close()
        self._failures = 0
        return self._no_reading(t_ns, "lost")

    def _look_for_bridge(self, t_ns: int) -> Bus | None:
        # looking for a bridge takes milliseconds, which the loop has not got each time
        if t_ns < self._look_at_ns:
            return None
        self._look_at_ns = t_ns + TRY_AGAIN_NS
        try:
            bus = self._bus = self._open_bus()
            freeing(bus, lambda: self._driven.bring_up_all(bus))
        except DeviceError:
            self.close()
            return None

        self._say(f"{bus.name}: back")
        return bus

    def _no_reading(self, t_ns: int, why: str) -> SourceReading:
        """A reading without values, for one reason that holds for all fingers."""
        # what arrived at the muxes is unknown
        self._driven.forget_masks()
        count = len(self.fingers)
        nothing = np.full(self.n_channels, np.nan)
        none_valid = np.zeros(count, dtype=np.bool_)
        reasons = (why,) * count
        self._report_changes(reasons)
        return SourceReading(t_ns, nothing, none_valid, reasons)

    def _complain(self, error: DeviceError) -> None:
        """Report what is wrong with bus or bridge, once until a scan has gone well."""
        # one line for a failure that lasts, not one for each scan
        if str(error) != self._complaint:
            self._say(str(error))
        self._complaint = str(error)

    def _report_changes(self, why: tuple[str, ...]) -> None:
        """Report what has changed since the last scan, one line for each finger."""
        for k, (before, now) in enumerate(zip(self._last_why, why, strict=True), 1):
            if before != now:
                self._say(f"finger {k}: {now or 'good again'}")
        self._last_why = why
