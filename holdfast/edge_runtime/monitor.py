"""The live path: a sealed model and a stream of samples become one Prediction a sample."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    CLASSES,
    NOTHING,
    RATE_TOLERANCE,
    SINCE_BOOT,
    SITUATIONS,
    BoolArray,
    CommandLink,
    FloatArray,
    Prediction,
    Reason,
    Sample,
    State,
    averaged_by,
)
from holdfast.core.errors import ChannelError, RateError, TimeError, UnitError
from holdfast.core.schema import shipped
from holdfast.edge_runtime.decision import UNKNOWN, DecisionState, decide, period_us
from holdfast.edge_runtime.health import (
    FrozenWatch,
    LoadedStart,
    RateWatch,
    RepeatWatch,
)
from holdfast.edge_runtime.model import (
    Model as Model,  # both from here, as the README does
)
from holdfast.edge_runtime.model import answer_names, situations_of
from holdfast.edge_runtime.model_file import ModelCard

if TYPE_CHECKING:
    from holdfast.core.hand_card import HandCard
    from holdfast.edge_runtime.engine import OpenedModel
    from holdfast.edge_runtime.recording import Answers

NOW_NS = partial(time.clock_gettime_ns, SINCE_BOOT)
RECORDED_NS = 60_000_000_000
"""No hand is read a minute late: a sample of that age comes from a recording, or another clock."""
RECORDED = (
    "samples that are a minute old or more, as of a recording: every answer is late and unknown. "
    "Use monitor.replay(values, t_s), or holdfast.load(model, live=False) and feed"
)
MOST_NS = 1 << 62
"""146 years, or so many samples: differences of two are int64 then."""
OLDEST_PERIODS = 2.0
"""An answer that is older than this is late: `late` is set, and its state is unknown."""
_STATES: tuple[State, ...] = ("nothing", "grasp", "safe_slip", "risky_slip")


class _Feed(NamedTuple):
    """One call of `feed`. repeated: the sample has come before."""

    sample: Sample
    repeated: bool
    opening: bool
    override: bool
    commands: CommandLink


class GripMonitor:
    """Feeds prepared samples to a model and turns its outputs into predictions.

    clock_ns: the monotonic clock of the samples' stamps; None for a replay, whose answers are never
    late and whose latency is the computing time. bias_known: the samples' bias was measured on the
    unloaded hand and stored, so that a start under load can be detected. has_counters: a counter in
    each chip says which readings are new, as the driver's do; else single sensors that freeze are
    found by their readings, and count as lost.
    """

    def __init__(
        self,
        model: OpenedModel,
        clock_ns: Callable[[], int] | None = NOW_NS,
        *,
        bias_known: bool = False,
        has_counters: bool = False,
    ) -> None:
        self.card = model.card
        self.engine = model.engine
        """What steps the model, as a line for people; "" for onnxruntime without more to say."""
        self._model = model
        self._fill = self.card.filler()
        self._graph = model.stepper(answer_names(self.card))
        self._clock_ns = clock_ns
        self._bias_known = bias_known
        self._has_counters = has_counters
        self._period_us = period_us(self.card.rate_hz)
        self._oldest_ns = round(OLDEST_PERIODS * 1e9 / self.card.rate_hz)
        self._fed_ns = 0
        self.stepped_ns = 0
        """When the graph finished the last sample."""
        self.reset()

    def feed(
        self,
        sample: Sample,
        *,
        opening: bool = False,
        override: bool = False,
        commands: CommandLink = "none",
    ) -> Prediction:
        """One sample in, one prediction out. values [C]: without bias, in the model's unit.

        An axis that the model's hand does not measure may hold anything: 0.0 goes to the model.

        Samples that never came (a gap in t_ns) count as lost: the graph is stepped over them, and a
        gap of more than 20 ms makes the state unknown until the history is complete again. A sample
        that comes twice, with the same time and the same sequence, is answered again and counts
        once. Raises ChannelError, and TimeError where time runs backwards or no clock gives it.

        The state is unknown, and `why` gives the reason, where the samples cannot be trusted
        (edge_runtime/health.py): the whole hand repeats itself, the rate is not the model's, or the
        answer is late. A frozen sensor counts as lost: the answer is `degraded`, or unknown where
        the model needs that sensor. opening, override, commands: what the wearer commands now.
        """
        self._require_shape(sample)
        self._require_stamp(sample)

        self._fed_ns = time.perf_counter_ns()

        # The same sample twice must not count twice: two risky samples in a row are a request to
        # act.
        stamp = (sample.t_ns, sample.sequence)
        repeated = stamp == (self._last_t_ns, self._last_sequence)
        if not repeated:
            self._bridge_gap(sample.t_ns)
            values = self._fill(sample.values)
            frozen = self._watch(sample, values)
            np.copyto(self._graph.sample[0], values)
            # True only where a sensor is valid and not frozen
            np.greater(sample.valid, frozen, out=self._graph.valid[0])
            self._graph.step()

        self.stepped_ns = self._now_ns(sample)
        return self._predict(_Feed(sample, repeated, opening, override, commands))

    def replay(
        self,
        values: npt.ArrayLike,
        t_s: npt.ArrayLike | None = None,
        *,
        valid: npt.ArrayLike | None = None,
        unit: str | None = None,
        bias: npt.ArrayLike | None = None,
    ) -> Answers:
        """The answers at all samples of a recording, as arrays; the stream of `feed` goes on as is.

        values: [T, C] as recorded. t_s: [T] in seconds, from any zero; None for the model's rate.
        valid: [T, C/3], None where every finite reading counts. unit: of values, N, mN, gf, uT, mT
        or count; None for the model's. bias: what the unloaded hand reads, [C] in the same unit; 0
        where it is removed already; None to take it from the first rows, as the model's card says.
        The hand must be empty then. Raises ChannelError, TimeError, UnitError or RateError.

        The answers are those of `feed`, each at the time of its sample, so none is late.
        """
        from holdfast.edge_runtime.recording import answers_of, prepared_recording

        card = self.card
        recording = prepared_recording(
            card, values, t_s, valid=valid, unit=unit, bias=bias
        )
        require_fit(
            card,
            n_channels=card.n_channels,
            unit=recording.unit,
            rate_hz=recording.rate_hz,
            where="replay",
        )
        # without a clock, and not this one: the stream that is fed is not disturbed
        monitor = GripMonitor(self._model, None, bias_known=bias is not None)
        return answers_of(recording, [monitor.feed(sample) for sample in recording])

    def reset(self) -> None:
        """Forget the stream; the next sample starts fresh and unsettled."""
        card = self.card
        self._graph.reset()
        self._decision = DecisionState()
        self._last_t_ns: int | None = None
        self._last_sequence: int | None = None

        # as long as the history: a hand that is stuck is unknown before it can look settled
        most_repeats = max(1, card.settle_samples - 1)
        n_sensors = card.n_channels // 3
        self._repeats = RepeatWatch(n_sensors, most_repeats)
        self._frozen: FrozenWatch | None = None
        if not self._has_counters:
            self._frozen = FrozenWatch(n_sensors, card.rate_hz)
        self._rate = RateWatch(card.rate_hz, card.settle_samples)
        self._start: LoadedStart | None = None
        if self._bias_known:
            self._start = LoadedStart(
                card.normal_floor, card.rate_hz, card.min_valid_sensors
            )

        self._stuck = False
        self._rate_fits = True

    def lose_track(self) -> None:
        """Forget the stream: unknown until settled again; an active request continues."""
        self._graph.reset()
        self._rate.forget()
        self._last_t_ns = None

    def _require_shape(self, sample: Sample) -> None:
        """Raise ChannelError for a sample of another hand."""
        channels = self.card.n_channels
        values = sample.values.shape
        flags = sample.valid.shape
        if values != (channels,) or flags != (channels // 3,):
            raise ChannelError(
                f"a sample of {values} values and {flags} flags, "
                f"the model wants {channels} channels of {channels // 3} sensors",
                next_step="use a model made for this source",
            )

    def _require_stamp(self, sample: Sample) -> None:
        """Raise TimeError for a time or a number that no clock or counter gives."""
        if not (-MOST_NS < sample.t_ns < MOST_NS and abs(sample.sequence) < MOST_NS):
            raise TimeError(
                f"a sample at {sample.t_ns} ns, number {sample.sequence}",
                next_step="give t_ns of a monotonic clock in ns, and count samples from 0",
            )

    def _bridge_gap(self, t_ns: int) -> None:
        """Step over the samples that are missing since the last one, as invalid samples."""
        passed_ns = 0 if self._last_t_ns is None else t_ns - self._last_t_ns
        if passed_ns < 0:
            raise TimeError(
                f"a sample {-passed_ns / 1e6:.3f} ms older than the one before it",
                cause="a clock that was set, or samples out of order",
                next_step="reset the monitor and start again",
            )

        self._last_t_ns = t_ns
        missing = round(passed_ns * 1e-9 * self.card.rate_hz) - 1
        self._graph.valid[:] = False

        # the state is the same for every longer gap
        for _ in range(min(missing, self.card.gap_samples + 1)):
            self._graph.step()

    def _watch(self, sample: Sample, values: FloatArray) -> BoolArray | bool:
        """Pass the sample to every watch that judges whether samples can be trusted.

        values [C]: as the model gets them. Returns which sensors [S] are frozen, False for none.
        """
        self._last_sequence = sample.sequence
        inside = np.abs(values) < self.card.range_limit  # False for NaN
        usable = sample.valid & inside.reshape(-1, 3).all(axis=1)
        self._stuck = self._repeats.stuck(values, usable)
        self._rate_fits = self._rate.fits(sample.t_ns, sample.sequence)
        if self._start is not None:
            self._start.take(values, usable)
        if self._frozen is None:
            return False
        return self._frozen.frozen(values, usable)

    def _now_ns(self, sample: Sample) -> int:
        """The clock's time; in a replay, the sample's time plus the computing time."""
        if self._clock_ns is not None:
            return self._clock_ns()
        return sample.t_ns + time.perf_counter_ns() - self._fed_ns

    def _predict(self, feed: _Feed) -> Prediction:
        """The answer; a second one, with an unknown state, where the first came too late."""
        before = self._decision
        why = self._why_unknown()
        prediction = self._answer(feed, why)
        age_ns = prediction.t_decided_ns - feed.sample.t_ns
        if self._clock_ns is None or abs(age_ns) <= self._oldest_ns:
            return prediction

        if age_ns > RECORDED_NS:
            warnings.warn(RECORDED, stacklevel=3)

        # what the late answer decided must not count
        self._decision = before
        is_late = age_ns > 0
        prediction = self._answer(feed, why or ("late" if is_late else "clock"))

        return replace(prediction, late=is_late)

    def _why_unknown(self) -> Reason:
        """Why the state is unknown, or "" where it is known."""
        out = self._graph.out
        start = self._start
        if out["unknown"][0]:
            return "sensors" if out["settled"][0] else "settling"
        if self._stuck:
            return "repeats"
        if not self._rate_fits:
            return "rate"

        never_empty = start is not None and not start.seen_empty
        if never_empty and out["situation"][0] == NOTHING:
            return "started_loaded"

        return ""

    def _decide(self, feed: _Feed, label: int) -> None:
        """Step the decision; a repeated sample counts for what the wearer commands only."""
        if feed.repeated:
            if not (feed.override or feed.opening):
                return
            label = UNKNOWN
        risky_permille = _risky_permille(self._graph.out["votes"][0])
        self._decision = decide(
            self.card.decision,
            self._decision,
            label,
            risky_permille,
            period_us=self._period_us,
            opening=feed.opening,
            override=feed.override,
        )

    def _label(self, degraded: bool) -> int:
        """The situation that the hand goes by."""
        out = self._graph.out
        # a whole hand pays nothing for the rule of a degraded one
        if not degraded:
            return int(out["situation"][0])
        return int(situations_of(out, self.card.n_channels // 3)[0])

    def _answer(self, feed: _Feed, why: Reason) -> Prediction:
        """The decision and the prediction of one sample. why: "" where its state is known."""
        card = self.card
        out = self._graph.out
        sample = feed.sample
        usable = int(out["usable_sensors"][0])
        degraded = not why and usable < card.n_channels // 3
        label = UNKNOWN if why else self._label(degraded)
        self._decide(feed, label)
        state: State = "unknown" if why else _STATES[label]

        # an empty hand holds nothing that could be light or heavy
        p_class: dict[str, float] | None = None
        weight: Literal["light", "heavy"] | None = None
        if card.has_weight and state not in ("unknown", "nothing"):
            p_class = _by_name(CLASSES, out["p_class"][0])
            weight = "heavy" if out["weight"][0] else "light"

        p_situation = _by_name(SITUATIONS, out["p_situation"][0])
        fired = out["detectors"][0].tolist()
        # after everything else, so that the latency counts all of it
        decided_ns = self._now_ns(sample)

        return Prediction(
            sequence=sample.sequence,
            t_acquired_ns=sample.t_ns,
            t_decided_ns=decided_ns,
            latency_us=(decided_ns - sample.t_ns) / 1000.0,
            state=state,
            why=why,
            p_situation=p_situation,
            p_risky=p_situation["risky_slip"],
            p_class=p_class,
            weight=weight,
            extra={name: float(out[name][0]) for name in card.heads},
            detectors=dict(zip(card.detectors, fired, strict=True)),
            arm=self._decision.arm,
            act=self._decision.act,
            act_ended=self._decision.ended,
            opening=feed.opening,
            overridden=self._decision.overridden,
            commands=feed.commands,
            late=False,
            started_loaded=None if self._start is None else self._start.loaded,
            degraded=degraded,
            settled=bool(out["settled"][0]),
            model_id=card.model_id,
        )


def _risky_permille(votes: Any) -> int:
    """Risky share of the votes in thousandths (of eight classes, the last two are risky)."""
    # whole numbers, so that no rounding differs; Python adds eight sooner than numpy
    counts = votes.tolist()
    risky = sum(counts[len(counts) * 3 // 4 :])
    return 1000 * int(risky) // int(sum(counts))


def _by_name(names: tuple[str, ...], values: Any) -> dict[str, float]:
    """Python floats by name, as messages have them."""
    return dict(zip(names, values.tolist(), strict=True))


def require_fit(
    card: ModelCard,
    *,
    n_channels: int,
    unit: str,
    rate_hz: float,
    where: str | Path,
    losses: str = "",
) -> None:
    """Raise ChannelError, UnitError or RateError where a source does not fit the model.

    losses: what makes its rate smaller than that of its sender, in words.
    """
    if n_channels != card.n_channels:
        raise ChannelError(
            f"the source has {n_channels} channels, the model needs {card.n_channels}",
            where=where,
            cause="a model made for other sensors",
            next_step="holdfast export MODEL --hand CARD --out FILE, or holdfast train",
        )

    if unit != card.unit:
        raise UnitError(
            f"the source is in {unit}, the model needs {card.unit}",
            where=where,
            cause="a hand without its calibration, or no unit in meta.json",
            next_step="use --calibration FILE (holdfast calibrate), or a model for this unit",
        )

    if averaged_by(rate_hz, card.rate_hz) != 1:
        raise RateError(
            f"{rate_hz:.4g} Hz, the model needs {card.rate_hz:.4g} Hz within {RATE_TOLERANCE:.0%}",
            where=where,
            cause=losses or "a model made for another rate",
            next_step="correct the sender" if losses else model_for_rate(rate_hz),
        )


def require_measured(card: ModelCard, hand: HandCard | None, where: str | Path) -> None:
    """Raise ChannelError where a hand does not measure an axis that the model needs.

    hand: that of a source or a set, None where none is known. What it measures more goes to no
    model (ModelCard.filler).
    """
    if hand is None or not hand.unmeasured_names:
        return
    needs = card.hand.unmeasured_names if card.hand else ()
    lacks = [name for name in hand.unmeasured_names if name not in needs]
    if lacks:
        raise ChannelError(
            f"{', '.join(lacks)}: not measured by the hand {hand.name}, and the model needs it",
            where=where,
            cause="a model made for sensors of three axes",
            next_step="holdfast export MODEL --hand CARD --out FILE, with this hand's card",
        )


def model_for_rate(rate_hz: float) -> str:
    """What to do with samples at a rate: the shipped model that takes them, or how to train one.

    >>> model_for_rate(200.0)
    'use holdfast-50hz, a shipped model'
    >>> model_for_rate(70.0)
    'holdfast train --data SET --out DIR --rate 70'
    """
    fitting = []
    for name in shipped():
        made_for = re.fullmatch(r"holdfast-(\d+)hz", name)
        n = averaged_by(rate_hz, float(made_for[1])) if made_for else 0
        if n:
            fitting.append((n, name))
    if fitting:
        return f"use {min(fitting)[1]}, a shipped model"
    return f"holdfast train --data SET --out DIR --rate {rate_hz:.4g}"
