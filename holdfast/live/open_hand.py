"""`holdfast.open_hand(url)`: a source of samples for a program of one's own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from holdfast.core.contract import Sample
from holdfast.core.source import SelfPaced
from holdfast.drivers.replay import at_rate
from holdfast.edge_runtime.monitor import GripMonitor, require_fit
from holdfast.live.hand_files import force_of, resting_of, tare_of
from holdfast.live.running import RunClock, say
from holdfast.live.sources import open_live


class OpenHand(ExitStack):
    """A source that is read now; close it, or use it in a `with` block.

    url, calibration, bias: as for `holdfast run`. Raises UsageError, DeviceError or DataError.
    """

    def __init__(
        self,
        url: str,
        calibration: str | Path | None = None,
        bias: str | Path | None = None,
    ) -> None:
        super().__init__()
        self.url = url
        self._clock = RunClock()
        to_force = force_of(calibration)
        self._source = open_live(url, clock=self._clock, report=say, to_force=to_force)
        self.callback(self._source.close)
        try:
            self._resting = resting_of(bias, self._source)
        except BaseException:
            self.close()
            raise

    def samples(
        self, monitor: GripMonitor, *, seconds: float | None = None
    ) -> Iterator[Sample]:
        """Samples for a monitor, on time and at its rate, until the source ends.

        seconds: end after so many. Without a file of the bias it is taken from the first rows, as
        the model's card says; until then no sensor is valid, and the hand must be empty. Raises
        UnitError, ChannelError or RateError where the source does not fit the model.
        """
        card = monitor.card
        source = at_rate(self._source, card.rate_hz, say)
        rate_hz = source.rate_hz or card.rate_hz
        require_fit(
            card,
            n_channels=source.n_channels,
            unit=source.unit,
            rate_hz=rate_hz,
            where=self.url,
        )

        tare = tare_of(card, source, self._resting)
        start_ns = self._clock.now_ns()
        sequence = 0
        while seconds is None or sequence < seconds * rate_hz:
            # an absolute schedule: a late sample delays no other one
            if not isinstance(source, SelfPaced):
                self._clock.wait_until(start_ns + round(1e9 * sequence / rate_hz))
            reading = source.read()
            if reading is None:
                return
            # the model was trained on values without the bias of the unloaded hand
            values, valid = tare.prepare(reading.values, reading.valid)
            yield Sample(reading.t_ns, values, valid, sequence)
            sequence += 1
