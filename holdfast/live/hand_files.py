"""The files of a hand, and its zero where it has none: calibration, shear gain and bias.

OpenHand (`holdfast.open_hand`) is a hand with them, for a program of one's own.

Where no bias was measured, the zero is taken from the first samples. ZeroWatch warns where that
was a closed hand, and where a measured bias is not that of the hand any more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    BoolArray,
    FloatArray,
    GripCommand,
    IntArray,
    Prediction,
    Sample,
)
from holdfast.core.errors import DataError, UnitError
from holdfast.core.hand_card import sensor_names
from holdfast.core.source import Source, SourceReading, Turns
from holdfast.drivers.replay import at_rate, hand_of, zero_of
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.monitor import GripMonitor, require_fit, require_measured
from holdfast.edge_runtime.preparation import Preparation, Tare
from holdfast.live.running import RunClock, say
from holdfast.live.sources import SIM, ToForce, open_live, source_url

if TYPE_CHECKING:
    from holdfast.drivers.calibration import Bias

SILENT_S = 2.0
"""A sensor that was not valid for so long after the start is named."""
HARDEST_N = 200.0
"""No fingertip is pressed harder, by a hand or by a probe."""
PULLS_FLOORS, PULLS_S = 2.0, 0.1
"""A fingertip is not pulled at: it reads so many touches (normal_floor) below zero, for so long,
where its zero was taken from a closed hand."""


@dataclass
class AnswerWatch:
    """An output of a run that names the sensors which have not answered for SILENT_S."""

    card: ModelCard
    report: Callable[[str], None]

    def __post_init__(self) -> None:
        self._names = sensor_names(self.card.hand, self.card.n_channels // 3)
        self._heard: BoolArray = np.zeros(len(self._names), dtype=np.bool_)
        self._left = round(SILENT_S * self.card.rate_hz)

    def _report_silent(self, trouble: str) -> None:
        """Name the sensors that have never been valid, where some sample came."""
        if self._heard.any() and not self._heard.all():
            names = [self._names[k] for k in np.flatnonzero(~self._heard)]
            self.report(f"{', '.join(names)} {trouble}")

    def write(
        self,
        prediction: object,
        sample: Sample,
        reading: SourceReading,
        command: object = None,
    ) -> None:
        self._heard |= reading.valid
        self._left -= 1
        if self._left == 0:
            self._report_silent(
                "has not answered yet; next: check its wires, or the columns of the sender"
            )

    def close(self, reason: str = "") -> None:
        """Name them once more: the message may have scrolled away."""
        self._report_silent("never answered")


@dataclass
class ZeroWatch:
    """An output of a run that says when its zero is wrong, and when it is taken.

    card: of the model, whose unit the samples have. measured: the bias that was measured, in words;
    "" where the zero is taken from the first samples.
    """

    card: ModelCard
    report: Callable[[str], None]
    measured: str = ""

    def __post_init__(self) -> None:
        self._names = sensor_names(self.card.hand, self.card.n_channels // 3)
        self._longest = max(1, round(PULLS_S * self.card.rate_hz))
        self._below: IntArray = np.zeros(len(self._names), dtype=np.int64)
        self._taken = bool(self.measured)
        self._warned = False
        if not self.measured:
            rows = self.card.preparation.bias_rows
            self.report(
                f"no --bias: the zero is taken from the first {rows} samples; keep the hand open "
                "and touch nothing"
            )

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: SourceReading,
        command: GripCommand | None = None,
    ) -> None:
        """Look at one prepared sample and its answer."""
        if not self._taken and sample.valid.all():
            self._taken = True
            self.report("the zero is taken: the hand may close now")
        if self._warned:
            return

        normal = sample.values[NORMAL_AXIS::3]
        unit, least = self.card.unit, -PULLS_FLOORS * self.card.normal_floor

        # samples in a row; one that is not below, or not valid, begins anew
        self._below += 1
        self._below[~(sample.valid & (normal < least))] = 0
        most = float(np.abs(normal[sample.valid]).max(initial=0.0))
        sensor = int(self._below.argmax())

        if unit == "N" and most > HARDEST_N:
            warning = (
                f"{most:.4g} N along a normal, and no hand presses with more than {HARDEST_N:g}: "
                "are these mN? Send N, or name the unit in a map"
            )
        elif self._below[sensor] > self._longest:
            why = "it was pressed when its zero was taken"
            if self.measured:
                why = f"the zero of {self.measured} is not its zero any more"
            warning = (
                f"sensor {sensor + 1} reads {normal[sensor]:.2g} {unit} along its normal, as if "
                f"pulled: {why} (open the hand and start again, or measure the zero with holdfast "
                "bias), or its normal axis points the other way (multiply it by -1 in the sender "
                "or a map)"
            )
        elif prediction.started_loaded:
            warning = self._loaded_in_words(sample)
        else:
            return
        self._warned = True
        self.report(f"warning: {warning}")

    def _loaded_in_words(self, sample: Sample) -> str:
        """Names the sensor that is the furthest from its zero."""
        sizes = np.linalg.norm(sample.values.reshape(-1, 3), axis=1)
        sizes[~sample.valid] = 0.0
        most = int(sizes.argmax())
        return (
            f"the hand was not empty since the start: {self._names[most]} reads "
            f"{sizes[most]:.3g} {self.card.unit}. If it holds nothing, the zero of {self.measured} "
            "is stale and the answers are wrong: open the hand, and measure it again with holdfast "
            "bias"
        )

    def close(self, reason: str = "") -> None:
        """Nothing to close."""


def force_of(path: str | Path | None) -> ToForce | None:
    """The map from field to force in a calibration file, or None. Raises a DataError."""
    if not path:
        return None
    from holdfast.drivers.calibration import read_calibration

    return read_calibration(Path(path)).apply


def shear_gain_of(url: str, calibration: str | Path | None) -> float | None:
    """Ratio of shear and normal force as read, over the true one; None where not measured.

    Of the calibration, else of the sensors that a scene emulates. Raises a DataError.
    """
    if calibration:
        from holdfast.drivers.calibration import read_calibration

        return read_calibration(Path(calibration)).shear_gain

    if url.startswith("virtual://"):
        from holdfast.simulation.effects.magnet import shear_gain

        return shear_gain()
    if not url.startswith(SIM):
        return None
    from holdfast.live.scene import trial_of
    from holdfast.simulation.effects.magnet import shear_gain_in

    return shear_gain_in(trial_of(source_url(url))[0].file.effects)


def resting_of(
    path: str | Path | None, source: Source, calibration: str | Path | None = None
) -> Bias | None:
    """A bias file that fits the source and its calibration, or None. Raises a DataError."""
    if not path:
        return None
    from holdfast.drivers.calibration import digest_of, read_bias

    bias = read_bias(Path(path))
    # a bias in another unit would be subtracted without any error
    if bias.unit != source.unit or len(bias.values) != source.n_channels:
        raise UnitError(
            f"{len(bias.values)} channels in {bias.unit}, "
            f"the source has {source.n_channels} in {source.unit}",
            where=path,
            cause="measured with another calibration or hand",
            next_step="run holdfast bias again",
        )

    digest = digest_of(calibration) if calibration else ""
    if bias.calibration is not None and bias.calibration != digest:
        raise DataError(
            f"measured with {_calibration_in_words(bias.calibration)}, and this hand is read with "
            f"{_calibration_in_words(digest)}",
            where=path,
            cause="the calibration was made anew, or another one was named",
            next_step="run holdfast bias again, with this calibration",
        )
    return bias


def _calibration_in_words(digest: str) -> str:
    return f"calibration {digest}" if digest else "no calibration"


def tare_of(
    card: ModelCard,
    source: Source,
    resting: FloatArray | None,
    where: str = "source",
) -> Tare:
    """What removes sign and zero from the samples of a source; resting [C]: a measured zero.

    Raises ChannelError, UnitError or RateError where the source does not fit the model.
    """
    # a polled hand has no rate of its own: it is read at that of the model
    rate_hz = source.rate_hz or card.rate_hz
    require_fit(
        card,
        n_channels=source.n_channels,
        unit=source.unit,
        rate_hz=rate_hz,
        where=where,
        losses=getattr(source, "losses", ""),
    )
    require_measured(card, hand_of(source), where)
    # the samples of another run have lost both already
    bare = card.preparation if zero_of(source) is None else Preparation()
    if resting is not None:
        resting = card.filler()(resting)
    return Tare(bare, card.n_channels, resting)


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
            measured = resting_of(bias, self._source, calibration)
        except BaseException:
            self.close()
            raise
        self._resting = None if measured is None else measured.values

    def samples(
        self, monitor: GripMonitor, *, seconds: float | None = None
    ) -> Iterator[Sample]:
        """Samples for a monitor, on time and at its rate, until the source ends.

        seconds: end after so many. Turns that pass while the program does something else are
        skipped, as in a live run: the sequence has a gap there. Without a file of the bias it is
        taken from the first rows, as the model's card says; until then no sensor is valid, and the
        hand must be empty. Raises UnitError, ChannelError or RateError where the source does not
        fit the model.
        """
        card = monitor.card
        source = at_rate(self._source, card.rate_hz, say)
        rate_hz = source.rate_hz or card.rate_hz
        tare, fill = tare_of(card, source, self._resting, self.url), card.filler()
        turns = Turns(source, self._clock, 1e9 / rate_hz)
        while seconds is None or turns.number < seconds * rate_hz:
            turns.wait()
            reading = source.read()
            if reading is None:
                return
            # the model was trained on values without the bias of the unloaded hand
            values, valid = tare.prepare(fill(reading.values), reading.valid)
            yield Sample(reading.t_ns, values, valid, turns.number)
            # the program may have taken its time with this sample
            turns.end()
