"""A stream of the lab streaming layer as a live source, and answers as such streams.

Stamps of the sender are put on this machine's clock, by the correction that LSL measures. The
source waits for the next sample, so the stream paces the loop. While no sample comes, the last
reading is given again, invalid: the state is unknown until the stream is back. Where samples come
faster than they are read, all but the newest are dropped, and one invalid reading stands for them.

The wearer's command from the lab streaming layer: words as text.

Stamps of the sender are put on the run's clock, by the correction that LSL measures.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

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
    RateError,
    UnitError,
    listed,
)
from holdfast.core.hand_lines import NOT_UNDERSTOOD, Skipped
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.wearer import Intent, intent_of

FIRST_S = 5.0
"""An opened stream must send within this time."""
WAIT_PERIODS = 1.5
"""A sample that comes later than this after the call is missing."""
MOST_WAITING = 2
FORWARD_NS = 1_000_000
"""The correction may be wrong by so much: a stamp may lie that far in the future."""
LOST = "no sample of the stream"
SKIPPED = "samples were dropped"
NO_NUMBER = "not a number"
DECISION = ("state", *(f"p_{name}" for name in SITUATIONS), "p_risky", "arm", "act")
UNKNOWN_STATE = -1.0
Pair = tuple[float, list[float]]
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


def order_of(labels: Sequence[str], where: str) -> list[int]:
    """Where X1, Y1, Z1, .. are: by their labels if these are the layout's, else as they come.

    Raises ChannelError.
    """
    count = len(labels)
    if not count or count % 3:
        raise ChannelError(
            f"{count} channels, not a multiple of three",
            where=where,
            next_step="send x, y, z of each sensor, or name another stream",
        )
    names = channel_names(count // 3)
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


class Inlet(Protocol):
    """An opened stream (holdfast/drivers/lsl_library.py)."""

    facts: StreamFacts

    def pull(self, timeout_s: float) -> list[Pair]:
        """(stamp in s on this machine's LSL clock, values) of all that came, oldest first."""
        ...

    def clock_s(self) -> float:
        """Now, on the same clock."""
        ...

    def close(self) -> None:
        """Stop receiving."""
        ...


class Outlet(Protocol):
    """A stream that is sent."""

    def push(self, values: list[float], stamp_s: float) -> None:
        """Send a sample without waiting."""
        ...


class _Stamped:
    """An inlet whose stamps are on the run's clock, and whose end is reported once."""

    def __init__(
        self, inlet: Inlet, now_ns: Callable[[], int], report: Callable[[str], object]
    ) -> None:
        self.inlet = inlet
        self._report = report
        self._ended = False
        # both clocks are monotonic, so one difference holds for the whole run
        self._offset_ns = now_ns() - round(1e9 * inlet.clock_s())

    def pull(self, timeout_s: float) -> list[tuple[int, list[Any]]]:
        """(stamp in ns, values) of all that came, oldest first; nothing after the end."""
        try:
            pairs = self.inlet.pull(timeout_s)
        except DeviceLost:
            if not self._ended:
                name = self.inlet.facts.name
                self._report(f"lsl://{name}: the stream ended; it is unknown from here")
            self._ended = True
            return []
        return [(round(1e9 * at_s) + self._offset_ns, values) for at_s, values in pairs]


class LslSource:
    """An inlet as a source.

    unit, rate_hz: None where the stream names them. report: receives a line when the stream ends.
    Raises ChannelError, UnitError, RateError, or DeviceNotFound where nothing is sent.
    """

    def __init__(
        self,
        inlet: Inlet,
        now_ns: Callable[[], int],
        report: Callable[[str], object],
        unit: Unit | None = None,
        rate_hz: float | None = None,
    ) -> None:
        facts = inlet.facts
        where = f"lsl://{facts.name}"
        self._stream = _Stamped(inlet, now_ns, report)
        self._now_ns = now_ns
        self._order = order_of(() if facts.is_text else facts.labels, where)
        self.n_channels = len(self._order)
        self.unit: Unit = unit or unit_of(facts.units, where)
        rate = rate_hz or facts.rate_hz
        if not rate > 0.0:
            raise RateError(
                "its rate is irregular", where=where, next_step=f"{where}?rate_hz=150"
            )
        self.rate_hz: float | None = rate
        self._wait_s = WAIT_PERIODS / rate
        self._waiting = deque(self._stream.pull(FIRST_S)[-1:])
        if not self._waiting:
            raise DeviceNotFound(
                f"nothing was sent for {FIRST_S:g} s",
                where=where,
                next_step="start the sender",
            )
        self._last = self._reading(*self._waiting[0])

    def read(self) -> SourceReading:
        """The next sample, or the last reading again with no sensor valid."""
        self._waiting.extend(self._stream.pull(0.0 if self._waiting else self._wait_s))
        if not self._waiting:
            return self._last.without_values(LOST)
        if len(self._waiting) > MOST_WAITING:
            # the newest is kept: an old sample would delay every later one
            newest = self._waiting.pop()
            self._last = self._reading(*self._waiting[-1])
            self._waiting = deque([newest])
            return self._last.without_values(SKIPPED)
        self._last = self._reading(*self._waiting.popleft())
        return self._last

    def close(self) -> None:
        """Stop receiving."""
        self._stream.inlet.close()

    def _reading(self, t_ns: int, values: list[float]) -> SourceReading:
        now_ns = self._now_ns()
        # a small error of the correction is no sample from the future
        t_ns = now_ns if now_ns < t_ns <= now_ns + FORWARD_NS else t_ns
        ordered: FloatArray = np.array(values, dtype=np.float64)[self._order]
        finite = np.isfinite(ordered).reshape(-1, 3)
        valid: BoolArray = np.logical_and.reduce(finite, axis=1)
        why = tuple("" if one else NO_NUMBER for one in valid)
        return SourceReading(t_ns, ordered, valid, why)


class LslAnswers:
    """Sends each sample and its answer as two streams, stamped with the sample's time.

    samples: the prepared values, nan where a sensor is not valid. decisions: DECISION, state as an
    index of SITUATIONS or UNKNOWN_STATE. offset_ns: of the clock of stamps over the LSL clock.
    not_learned: what the model cannot tell, nan in each decision.
    """

    def __init__(
        self,
        samples: Outlet,
        decisions: Outlet,
        offset_ns: int,
        not_learned: Collection[str] = (),
    ) -> None:
        self._not_learned = not_learned
        self._samples = samples
        self._decisions = decisions
        self._offset_ns = offset_ns

    def write(
        self, prediction: Prediction, sample: Sample, reading: object = None
    ) -> None:
        """Send both without waiting."""
        stamp_s = 1e-9 * (sample.t_ns - self._offset_ns)
        # receivers must not take a held value for a measured one
        values = np.where(np.repeat(sample.valid, 3), sample.values, np.nan)
        self._samples.push(values.tolist(), stamp_s)
        decision = decision_row(prediction, self._not_learned)
        self._decisions.push(decision, stamp_s)

    def close(self, reason: str = "") -> None:
        """The streams end with the program."""


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


class LslIntent:
    """An inlet as a stream of items. A text stream has words in its first channel."""

    def __init__(
        self, inlet: Inlet, now_ns: Callable[[], int], report: Callable[[str], object]
    ) -> None:
        self._stream = _Stamped(inlet, now_ns, report)
        self._now_ns = now_ns
        self._is_text = inlet.facts.is_text
        self._skipped = Skipped("wearer", report, now_ns)

    def __call__(self) -> list[Intent]:
        """What came; the newest stamp is not in the future."""
        items = [self._item(t_ns, values) for t_ns, values in self._stream.pull(0.0)]
        return [one for one in items if one is not None]

    def _item(self, t_ns: int, values: Sequence[Any]) -> Intent | None:
        wants = values[0] if self._is_text else ""
        try:
            return intent_of(wants, min(t_ns, self._now_ns()))
        except ValueError as error:
            shown = f"{str(values)[:80]} is skipped: {NOT_UNDERSTOOD} ({error})"
            self._skipped.count(NOT_UNDERSTOOD, shown)
            return None
