"""The lab streaming layer by pylsl, which only this module imports: a live source, words, answers.

Streams are found by name on the local network, and all machines there can receive what is sent.
liblsl's own file `lsl_api.cfg` restricts both, to this machine for instance (docs/formats.md).

Stamps of the sender are put on the run's clock, by the correction that LSL measures. A source waits
for the next sample, so the stream paces the loop. A stream that ended leaves it unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.contract import (
    RISKY_SLIP,
    SITUATIONS,
    UNITS,
    BoolArray,
    FloatArray,
    Prediction,
    Sample,
    Unit,
    channel_names,
)
from holdfast.core.errors import (
    ChannelError,
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    RateError,
    UnitError,
    listed,
    needs_extra,
)
from holdfast.core.hand_card import HandCard, fill_unmeasured, leave_empty
from holdfast.core.hand_lines import NOT_UNDERSTOOD, SkippedLines
from holdfast.core.source import SourceReading
from holdfast.drivers.arrivals import Arrivals
from holdfast.edge_runtime.wearer import Intent, intent_of

try:
    with needs_extra("lsl"):
        import pylsl
        from pylsl.util import LostError
except RuntimeError:  # pylsl's own, where its wheel has no liblsl
    raise LibraryMissing(
        "no liblsl",
        where="pylsl",
        cause="the wheel of pylsl for this processor does not bring it (x86_64 only)",
        next_step="install liblsl, or name it in PYLSL_LIB (docs/formats.md)",
    ) from None

FIND_S = FIRST_S = 5.0
"""A stream must be found within this time, and an opened one must send."""
KEPT_S = 2
"""An inlet keeps what is not read for so long."""
MOST_AT_ONCE = 4096
FORWARD_NS = 1_000_000
"""The correction may be wrong by so much: a stamp may lie that far in the future."""
NO_NUMBER = "not a number"
SAME_STAMP = "stamped like the one before"
DECISION = ("state", *(f"p_{name}" for name in SITUATIONS), "p_risky", "arm", "act")
UNKNOWN_STATE = -1.0
UNIT_WORDS: dict[str, Unit] = {
    "n": "N",
    "newton": "N",
    "newtons": "N",
    "ut": "uT",
    "µt": "uT",
    "microtesla": "uT",
    "count": "count",
    "counts": "count",
}
"""What streams write for a unit, in lower case."""


@dataclass(frozen=True)
class StreamFacts:
    """Of a stream. rate_hz: 0 where it is irregular. labels, units [C]: "" where it has none."""

    name: str
    is_text: bool
    rate_hz: float
    labels: tuple[str, ...]
    units: tuple[str, ...]


def order_of(
    labels: Sequence[str], where: str, hand: HandCard | None = None
) -> list[int]:
    """Where X1, Y1, Z1, .. are: by their labels if these are the layout's, else as they come.

    hand: a stream may leave out what it does not measure. Raises ChannelError.
    """
    count = len(labels)
    names = channel_names(hand.n_sensors if hand else count // 3)
    if hand is not None and count < len(names):
        names = tuple(name for name in names if name not in hand.unmeasured_names)
    if not count or count != len(names):
        whole = f"{len(names)} of the hand card" if hand else "a multiple of three"
        raise ChannelError(
            f"{count} channels, not {whole}",
            where=where,
            next_step="send x, y, z of each sensor, or name another stream; what a hand does not "
            f"measure may be left out: {where}?hand=CARD",
        )
    # labels in another order are sorted; labels of another kind say nothing about order
    by_name = set(labels) == {*names}
    return [labels.index(name) for name in names] if by_name else [*range(count)]


def unit_of(units: Sequence[str], where: str) -> Unit:
    """The one unit of all channels. Raises UnitError."""
    words = {one.strip().lower() for one in units}
    known = {UNIT_WORDS.get(word) for word in words}
    # all channels must have one unit, and it must be one of ours
    (unit,) = known if len(known) == 1 else (None,)
    if unit is None:
        raise UnitError(
            f"the stream names no unit of ours ({listed(sorted(words - {''})) or 'nothing'})",
            where=where,
            cause=f"its channels have no unit of {', '.join(UNITS)}",
            next_step=f"{where}?unit={'|'.join(UNITS)}",
        )
    return unit


# -- what comes in


class LslInlet:
    """An opened stream. Raises DeviceNotFound where none has this name.

    ended: it cannot come back.
    """

    ended = False

    def __init__(self, name: str) -> None:
        found = pylsl.resolve_byprop("name", name, 1, FIND_S)
        if not found:
            raise DeviceNotFound(
                "no such stream on the network",
                where=f"lsl://{name}",
                cause="it is not sent yet, has another name, or a firewall blocks it",
                next_step="start the sender first; LabRecorder lists streams by name",
            )

        # 1: no sample waits for others
        self._inlet: Any = pylsl.StreamInlet(found[0], KEPT_S, 1)
        try:
            self.facts = _facts(self._inlet.info(FIND_S))
            self._inlet.open_stream(FIND_S)
            self._inlet.time_correction(FIND_S)
        except (TimeoutError, LostError) as error:
            raise DeviceNotFound(
                f"the stream does not open ({type(error).__name__})",
                where=f"lsl://{name}",
                cause="its sender just ended, or a firewall blocks its data",
                next_step="start the sender again",
            ) from None

    def pull(self, timeout_s: float) -> list[tuple[float, list[Any]]]:
        """(stamp in s on this machine's LSL clock, values) of all samples that came, oldest first.

        Waits at most timeout_s for the first. Raises DeviceLost where the stream cannot come back.
        """
        try:
            first, stamp = self._inlet.pull_sample(timeout_s)
            if first is None:
                return []
            # the first call waited; this one takes what else has come
            rows, stamps = self._inlet.pull_chunk(0.0, MOST_AT_ONCE)
            correction_s = self._inlet.time_correction(FIND_S)
        except (TimeoutError, LostError):
            raise DeviceLost(
                "the stream ended", where=self.facts.name, cause="its sender ended"
            ) from None

        pairs = zip([stamp, *stamps], [first, *rows], strict=True)
        return [(correction_s + at_s, values) for at_s, values in pairs]

    def clock_s(self) -> float:
        """Now, on this machine's LSL clock."""
        return float(pylsl.local_clock())

    def begin(self, now_ns: Callable[[], int], report: Callable[[str], object]) -> None:
        """From here on `stamped` is on the run's clock; report: receives a line at the end."""
        self._report = report
        # both clocks are monotonic, so one difference holds for the whole run
        self._offset_ns = now_ns() - round(1e9 * self.clock_s())

    def stamped(self, timeout_s: float) -> list[tuple[int, list[Any]]]:
        """(stamp in ns, values) of all that came, oldest first; nothing after the end."""
        if self.ended:
            return []
        try:
            pairs = self.pull(timeout_s)
        except DeviceLost:
            name = self.facts.name
            self._report(f"lsl://{name}: the stream ended; it is unknown from here")
            self.ended = True
            return []
        return [(round(1e9 * at_s) + self._offset_ns, values) for at_s, values in pairs]

    def close(self) -> None:
        self._inlet.close_stream()


def _facts(info: Any) -> StreamFacts:
    # a sender may leave labels and units out, all of them or single ones
    none = [""] * info.channel_count()
    labels = info.get_channel_labels() or none
    units = info.get_channel_units() or none
    return StreamFacts(
        info.name(),
        info.channel_format() == pylsl.cf_string,
        info.nominal_srate(),
        tuple(label or "" for label in labels),
        tuple(unit or "" for unit in units),
    )


class LslSource(Arrivals):
    """An inlet as a source. clock: has now_ns and wait_until.

    unit, rate_hz: None where the stream names them. report: receives a line when the stream ends.
    hand: its card; None where it measures all. Raises ChannelError, UnitError, RateError, or
    DeviceNotFound where nothing is sent.
    """

    def __init__(
        self,
        inlet: LslInlet,
        clock: Any,
        report: Callable[[str], object],
        unit: Unit | None = None,
        rate_hz: float | None = None,
        hand: HandCard | None = None,
    ) -> None:
        facts = inlet.facts
        where = f"lsl://{facts.name}"
        super().__init__(where, clock, report)
        self._inlet = inlet
        self._stamp_ns: int | None = None
        inlet.begin(clock.now_ns, report)
        labels = () if facts.is_text else facts.labels
        self._order = order_of(labels, where, hand)
        self.hand = hand
        self.n_channels = 3 * hand.n_sensors if hand else len(self._order)
        # where each of them goes: a stream may leave out what is not measured
        self._places: Any = slice(None)
        if hand is not None and len(self._order) < self.n_channels:
            self._places = hand.measured
        self.unit: Unit = unit or unit_of(facts.units, where)
        self.rate_hz = rate_hz or facts.rate_hz
        if not self.rate_hz > 0.0:
            raise RateError(
                "its rate is irregular", where=where, next_step=f"{where}?rate_hz=150"
            )
        self.collect(FIRST_S)
        if not self.waiting:
            raise DeviceNotFound(
                f"nothing was sent for {FIRST_S:g} s",
                where=where,
                next_step="start the sender",
            )
        self.begin()

    def collect(self, timeout_s: float) -> None:
        """Take what has come; wait at most so long for the first of it."""
        for t_ns, values in self._inlet.stamped(timeout_s):
            # the loop counts it as lost
            if t_ns == self._stamp_ns:
                self.skipped.count(SAME_STAMP, f"a sample is {SAME_STAMP}")
            self._stamp_ns = t_ns
            self.waiting.append(self._reading(t_ns, values))
        if self._inlet.ended:
            # the loop goes on at its pace, and its state is unknown
            self.clock.wait_until(self.clock.now_ns() + round(1e9 * timeout_s))

    def close(self) -> None:
        self.skipped.close()
        self._inlet.close()

    def _reading(self, t_ns: int, values: list[float]) -> SourceReading:
        now_ns = self.clock.now_ns()
        # a small error of the correction is no sample from the future
        t_ns = now_ns if now_ns < t_ns <= now_ns + FORWARD_NS else t_ns
        ordered: FloatArray = np.full(self.n_channels, np.nan)
        ordered[self._places] = np.array(values, dtype=np.float64)[self._order]
        ordered = fill_unmeasured(ordered, self.hand)
        finite = np.isfinite(ordered).reshape(-1, 3)
        valid: BoolArray = np.logical_and.reduce(finite, axis=1)
        why = tuple("" if one else NO_NUMBER for one in valid)
        return SourceReading(t_ns, ordered, valid, why)


class LslIntent:
    """An inlet as a stream of items. A text stream has words in its first channel."""

    def __init__(
        self,
        inlet: LslInlet,
        now_ns: Callable[[], int],
        report: Callable[[str], object],
    ) -> None:
        self._inlet = inlet
        inlet.begin(now_ns, report)
        self._now_ns = now_ns
        self._skipped = SkippedLines("wearer", report, now_ns)

    def __call__(self) -> list[Intent]:
        """What came; the newest stamp is not in the future."""
        items = []
        for t_ns, values in self._inlet.stamped(0.0):
            wants = values[0] if self._inlet.facts.is_text else ""
            try:
                items.append(intent_of(wants, min(t_ns, self._now_ns())))
            except ValueError as error:
                shown = f"{str(values)[:80]} is skipped: {NOT_UNDERSTOOD} ({error})"
                self._skipped.count(NOT_UNDERSTOOD, shown)

        return items


# -- what goes out


class LslAnswers:
    """Sends each sample and its answer as two streams, NAME and NAME-decision.

    The samples are the prepared values, nan where a sensor is not valid; the decisions are
    DECISION, state as an index of SITUATIONS or UNKNOWN_STATE. Both have the sample's time. now_ns:
    the clock of the samples' stamps. not_learned: what the model cannot tell, nan in each decision.
    hand: the model's; nan for an axis that it does not measure.
    """

    def __init__(
        self,
        name: str,
        n_sensors: int,
        unit: Unit,
        rate_hz: float,
        now_ns: Callable[[], int],
        not_learned: Collection[str] = (),
        hand: HandCard | None = None,
    ) -> None:
        labels = channel_names(n_sensors)
        self._hand = hand
        units = [unit] * len(labels)
        self._samples = _outlet(name, "Tactile", rate_hz, labels, units)
        no_units = [""] * len(DECISION)
        self._decisions = _outlet(
            f"{name}-decision", "Decision", rate_hz, DECISION, no_units
        )
        self._offset_ns = now_ns() - round(1e9 * pylsl.local_clock())
        self._not_learned = not_learned

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: object = None,
        command: object = None,
    ) -> None:
        """Send both; threads of liblsl do it, so nothing waits."""
        stamp_s = 1e-9 * (sample.t_ns - self._offset_ns)
        # receivers must not take a held value for a measured one
        values = np.where(np.repeat(sample.valid, 3), sample.values, np.nan)
        values = leave_empty(values, self._hand)
        self._samples.push_sample(values.tolist(), stamp_s)
        decision = decision_row(prediction, self._not_learned)
        self._decisions.push_sample(decision, stamp_s)

    def close(self, reason: str = "") -> None:
        """The streams end with the program."""


def _outlet(
    name: str, kind: str, rate_hz: float, labels: Sequence[str], units: Sequence[str]
) -> Any:
    """A stream of doubles. By its source_id a receiver finds it again after a restart."""
    source_id = f"holdfast-{name}"
    info: Any = pylsl.StreamInfo(
        name, kind, len(labels), rate_hz, pylsl.cf_double64, source_id
    )
    info.set_channel_labels(list(labels))
    info.set_channel_units(list(units))
    return pylsl.StreamOutlet(info, 1)


def decision_row(
    prediction: Prediction, not_learned: Collection[str] = ()
) -> list[float]:
    """The values of DECISION. not_learned: what the model cannot tell, which is nan."""
    state = prediction.state
    known = state in SITUATIONS
    p = dict(prediction.p_situation)
    for name in not_learned:
        p[name] = math.nan
    return [
        float(SITUATIONS.index(state)) if known else UNKNOWN_STATE,
        *(p[name] for name in SITUATIONS),
        math.nan if SITUATIONS[RISKY_SLIP] in not_learned else prediction.p_risky,
        float(prediction.arm),
        float(prediction.act),
    ]
