"""What a model does in plain lifts, in which nothing falls: alarms, and what the grip would add.

All is of two pads and in open loop: the recorded hand did not get the targets. An alarm in a
lift is counted as false, because no slip was marked and nothing fell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from holdfast.core.contract import (
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    FloatArray,
    Json,
)
from holdfast.data.metrics import Interval, draw_groups
from holdfast.edge_runtime.batch import ManyHands
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.edge_runtime.grip import AnswerRules, GripSense, Holdfast
from holdfast.edge_runtime.grip_control import GripLoop
from holdfast.evaluation.alarms import DRAWS, match_alarms, ratio_interval, requests_at
from holdfast.evaluation.model_outputs import ModelOutputs

BEGIN_S, END_S = 0.2, 0.15
"""The first and the last part of a contact; what lies between is the hold."""
MIDDLE = (0.30, 0.75)
"""Shares of the contact between which the grip holds the object quietly."""
SQUEEZED_N = 1.0
"""A target this far above the recorded grip squeezes, N a side."""


GAIN = 1.0
"""Force transducers read all of the shear."""


@dataclass(frozen=True)
class LiftFigures:
    """One lift. Alarms by when they begin: in the first 0.2 s of contact, in the hold, in the last
    0.15 s. over_n: the largest target above the recorded grip in the middle of the hold, N a side;
    over_without_model_n: the same with all probabilities 0.
    """

    person: str
    object_name: str
    contact_s: float
    alarms_begin: int
    alarms_hold: int
    alarms_end: int
    over_n: float
    over_without_model_n: float

    @property
    def alarms(self) -> int:
        """All alarms of the contact."""
        return self.alarms_begin + self.alarms_hold + self.alarms_end


@dataclass(frozen=True)
class PersonRecordings:
    """The minutes of a person's recordings that count, and all alarms in them."""

    person: str
    minutes: float
    alarms: int


@dataclass(frozen=True)
class Lifts:
    """What a model does in some people's lifts."""

    recordings: tuple[PersonRecordings, ...]
    lifts: tuple[LiftFigures, ...]

    def __add__(self, other: Lifts) -> Lifts:
        return Lifts(self.recordings + other.recordings, self.lifts + other.lifts)


@dataclass(frozen=True)
class Rate:
    """A ratio of sums, with its 95 % interval over people; None where nothing can be drawn."""

    value: float | None
    ci: Interval | None


def lifts_of(
    outputs: Sequence[ModelOutputs], rules: DecisionRules, permille: int
) -> Lifts:
    """What a model does in recordings of lifts. outputs: of each recording, from a fresh state.

    rules: of the model's card; permille: the confidence from which it requests.
    """
    requests = requests_at(outputs, rules, permille)
    answers = AnswerRules.of(rules)
    targets_n = targets_of(outputs, answers)
    bare_n = targets_of(outputs, answers, with_model=False)
    recordings, lifts = [], []
    for one, on, target_n, bare in zip(
        outputs, requests, targets_n, bare_n, strict=True
    ):
        recording = one.recording
        person = recording.person or ""
        match = match_alarms(recording, on)
        recordings.append(PersonRecordings(person, match.minutes, len(match.false_s)))
        alarms = np.round(np.array(match.false_s) * recording.rate_hz).astype(np.int64)
        grip_n = grip_of(recording.samples)
        for phase in recording.phases:
            if phase.situation != GRASP:
                continue
            begin = phase.first + round(BEGIN_S * recording.rate_hz)
            end = max(begin, phase.stop - round(END_S * recording.rate_hz))
            edges = (phase.first, begin, end, phase.stop)
            counts = np.histogram(alarms, edges)[0] if begin < phase.stop else (0, 0, 0)
            length = phase.stop - phase.first
            middle = slice(
                phase.first + round(MIDDLE[0] * length),
                phase.first + round(MIDDLE[1] * length),
            )
            lifts.append(
                LiftFigures(
                    person=person,
                    object_name=recording.object_name or "",
                    contact_s=length / recording.rate_hz,
                    alarms_begin=int(counts[0]),
                    alarms_hold=int(counts[1]),
                    alarms_end=int(counts[2]),
                    over_n=float((target_n - grip_n)[middle].max(initial=-np.inf)),
                    over_without_model_n=float(
                        (bare - grip_n)[middle].max(initial=-np.inf)
                    ),
                )
            )
    return Lifts(tuple(recordings), tuple(lifts))


def grip_of(samples: FloatArray) -> FloatArray:
    """[T, C] -> [T] grip of a side, N: half the sum of the normal forces."""
    return 0.5 * np.maximum(samples[:, 2::3], 0.0).sum(axis=1)


def targets_of(
    outputs: Sequence[ModelOutputs], rules: AnswerRules, *, with_model: bool = True
) -> list[FloatArray]:
    """[T] a recording, the target of the grip, N a side; 0 for none.

    with_model: False for all probabilities 0, so that the forces alone decide.
    """
    longest = max(len(one.situation) for one in outputs)
    rate_hz = outputs[0].recording.rate_hz
    batch = ManyHands(len(outputs))
    loop = GripLoop(batch, rate_hz, Holdfast(batch, rate_hz, None, rules, GAIN))
    columns = _senses(outputs, longest, with_model)
    given = np.zeros((longest, len(outputs)))
    no = batch.false()
    for row in range(longest):
        sense = GripSense(
            grip_n=columns["grip_n"][row],
            load_n=columns["load_n"][row],
            p_risky=columns["p_risky"][row],
            p_safe=columns["p_safe"][row],
            known=columns["known"][row] > 0.0,
            empty=columns["empty"][row] > 0.0,
            opening=no,
            overridden=no,
        )
        given[row] = loop.step(sense)
    return [given[: len(one.situation), k] for k, one in enumerate(outputs)]


def _senses(
    outputs: Sequence[ModelOutputs], longest: int, with_model: bool
) -> Mapping[str, FloatArray]:
    """[longest, B] what the controller knows of each row; after its end a recording is unknown."""
    names = ("grip_n", "load_n", "p_risky", "p_safe", "known", "empty")
    columns = {name: np.zeros((longest, len(outputs))) for name in names}
    for k, one in enumerate(outputs):
        samples = one.recording.samples
        rows = slice(0, len(samples))
        shear = samples.reshape(len(samples), -1, 3)[:, :, :2]
        columns["grip_n"][rows, k] = grip_of(samples)
        columns["load_n"][rows, k] = np.linalg.norm(shear, axis=2).sum(axis=1)
        columns["known"][rows, k] = one.situation != UNKNOWN
        columns["empty"][rows, k] = one.situation == NOTHING
        if with_model:
            columns["p_risky"][rows, k] = one.p_situation[:, RISKY_SLIP]
            columns["p_safe"][rows, k] = one.p_situation[:, SAFE_SLIP]
    return columns


def summary(of: Lifts, seed: int = 0) -> Json:
    """The figures of a table's row, each a Rate as JSON."""
    contact_min = _by_person(of, lambda lift: lift.contact_s / 60.0)
    n_lifts = _by_person(of, lambda lift: 1.0)
    minutes = _sums(of, [(one.person, one.minutes) for one in of.recordings])
    alarms = _sums(of, [(one.person, float(one.alarms)) for one in of.recordings])
    ratios = {
        "alarms_a_minute_of_recording": (alarms, minutes),
        "alarms_a_minute_of_contact": (
            _by_person(of, lambda lift: lift.alarms),
            contact_min,
        ),
        "lifts_with_an_alarm": (_by_person(of, lambda lift: lift.alarms > 0), n_lifts),
        "alarms_a_minute_in_the_first_0_2_s": (
            _by_person(of, lambda lift: lift.alarms_begin),
            minutes,
        ),
        "alarms_a_minute_in_the_hold": (
            _by_person(of, lambda lift: lift.alarms_hold),
            minutes,
        ),
        "alarms_a_minute_in_the_last_0_15_s": (
            _by_person(of, lambda lift: lift.alarms_end),
            minutes,
        ),
        "lifts_squeezed": (
            _by_person(of, lambda lift: lift.over_n > SQUEEZED_N),
            n_lifts,
        ),
        "lifts_squeezed_without_model": (
            _by_person(of, lambda lift: lift.over_without_model_n > SQUEEZED_N),
            n_lifts,
        ),
    }
    figures: Json = {
        name: asdict(_rate(above, below, seed))
        for name, (above, below) in ratios.items()
    }
    figures["people"] = len(n_lifts)
    figures["lifts"] = len(of.lifts)
    figures["minutes"] = float(minutes.sum())
    over_n = [lift.over_n for lift in of.lifts]
    figures["over_median_n"] = float(np.median(over_n)) if over_n else None
    return figures


def parts_of(of: Lifts, key: Callable[[LiftFigures], str]) -> dict[str, Json]:
    """The share of lifts with an alarm, and of those squeezed, by something of a lift."""
    names = sorted({key(lift) for lift in of.lifts})
    rows = {}
    for name in names:
        lifts = [lift for lift in of.lifts if key(lift) == name]
        contact_min = sum(lift.contact_s for lift in lifts) / 60.0
        rows[name] = {
            "lifts": len(lifts),
            "alarms_a_minute_of_contact": sum(lift.alarms for lift in lifts)
            / contact_min,
            "lifts_with_an_alarm": float(np.mean([lift.alarms > 0 for lift in lifts])),
            "lifts_squeezed": float(
                np.mean([lift.over_n > SQUEEZED_N for lift in lifts])
            ),
        }
    return rows


def _by_person(of: Lifts, figure: Callable[[LiftFigures], float]) -> FloatArray:
    """[G] the sum of a figure over each person's lifts."""
    return _sums(of, [(lift.person, float(figure(lift))) for lift in of.lifts])


def _sums(of: Lifts, pairs: Sequence[tuple[str, float]]) -> FloatArray:
    """[G] sums by person, in the order of their names."""
    people = sorted({one.person for one in of.recordings})
    sums = dict.fromkeys(people, 0.0)
    for person, value in pairs:
        sums[person] += value
    return np.array(list(sums.values()))


def _rate(above: FloatArray, below: FloatArray, seed: int) -> Rate:
    """The ratio of two sums over people."""
    if not below.sum():
        return Rate(None, None)
    drawn = None
    if len(below) > 1:
        drawn = draw_groups(len(below), DRAWS, seed) @ np.stack([above, below], axis=1)
    return Rate(float(above.sum() / below.sum()), ratio_interval(drawn, 0, 1))
