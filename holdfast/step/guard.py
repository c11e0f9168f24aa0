"""The input guard: the rest of the graph gets finite values in range, and flags for missing ones.

A sample of a sensor is good if the driver marks it as valid and all three channels are finite and
in range. A bad one is replaced by the last good one, and the sensor's filter state is held. NaN
cannot pass: every comparison with NaN is false.

The history of a sensor is one number, its place, stepped by a table (`_tables`):

    0                            fresh: it has no past
    (delivered, lost in a row)   higher with more delivered samples, lower with more lost ones
    the last                     settled and good now: usable

More than 20 ms lost in a row lead back to 0, and the sensor must settle again. unknown = fewer
usable sensors than the model needs, or, where features are pooled, none on one side of the hand. A
short gap makes the state unknown while it lasts; a long one until the whole history is of good
samples again.

Where force decides "nothing" (`add_contact`), what the guard lets through is the sample less the
zero of its channel. The zero is 0 in a fresh state and follows the reading of an empty hand, never
that of a hand that touches something, and never while the state is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from onnx import TensorProto

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.model_file import EMPTY
from holdfast.step.builder import GraphBuilder
from holdfast.step.pooled import side_matrix
from holdfast.step.spec import RANGE_LIMIT, ContactRule, StepSpec


@dataclass(frozen=True)
class GuardOutputs:
    """Names of the guarded tensors, each [B, 1, C] but past, factors and count.

    now, last: this and the previous good sample. past: all samples before this one, in parts
    [B, rows, C], oldest first. alive: 1.0, or 0.0 where a loss has ended its past. weight: 1.0, or
    LEAST_WEIGHT where the sensor is not usable. still: share of a noise floor that no new sample
    changes, 1.0 where the sensor is not usable. factors: [B, 2, C], rows MOVED and USABLE: 0.0
    where the sensor has delivered nothing now or has no past to move on from; where it is not
    usable. count: [B, 1, 1] int64, of the hand (`_counted`). zero: what was taken from the sample;
    "" where force does not decide.
    """

    now: str
    last: str
    past: tuple[str, ...]
    alive: str
    weight: str
    still: str
    factors: str
    count: str
    zero: str


MOVED, USABLE = 0, 1
LEAST_WEIGHT = 1e-12
"""Of a sensor that is not usable: far below any weight that counts, so that nothing over nothing
is 1."""


def add_guard(graph: GraphBuilder, spec: StepSpec) -> GuardOutputs:
    """Add the guard; publishes settled [B], unknown [B] and usable_sensors [B]."""
    oldest = graph.state("oldest", 1)
    older = graph.state("older", spec.history_samples - 2)
    last = graph.state("last", 1)
    place = graph.state("place", 1)

    # the share is a sum of quarters, so a whole one is exactly 1
    share = _share_of_good(graph, spec)
    good = graph.node("Greater", share, 0.75)
    zero = ""
    reading = "sample"
    if spec.contact is not None:
        zero = graph.state("zero", 1)
        reading = graph.node("Sub", "sample", zero)

    # chosen, not multiplied: NaN x 0 is NaN
    now = graph.node("Where", good, reading, last)

    # Each row takes the value of the next newer one. The values differ in rows from their fields,
    # and only the sum of the rows is the same: joined behind each other and split again at the
    # next sample, they have moved on by one row without a copy of their own.
    graph.keep("oldest", older)
    graph.keep("older", last)
    graph.keep("last", now)

    # The cast rounds a share below 1 down. One look-up in all tables costs less than the
    # comparisons and choices of two counters, and no number of samples overflows it.
    tables = _tables(spec)
    all_tables = np.vstack(list(tables.values()))
    n_tables, length = all_tables.shape
    even_or_odd = graph.node("Add", place, share)
    behind_each_other = float(length) * np.arange(n_tables)[:, None]
    entry = graph.node("Add", even_or_odd, behind_each_other)
    whole = graph.node("Cast", entry, to=TensorProto.INT64)
    found = graph.node("Gather", all_tables.ravel(), whole)
    parts = graph.split(found, {name: len(table) for name, table in tables.items()})
    graph.keep("place", parts.pop("next_place"))

    count = _publish(graph, spec, parts.pop("adds"))
    past = (oldest, older, last)
    return GuardOutputs(now=now, last=last, past=past, count=count, zero=zero, **parts)


def _share_of_good(graph: GraphBuilder, spec: StepSpec) -> str:
    """[B, 1, C]: good quarters of a sensor: three channels in range, and the valid flag."""
    magnitude = graph.node("Abs", "sample")
    in_range = graph.node("Greater", RANGE_LIMIT[spec.unit], magnitude)
    flags = graph.node("Concat", in_range, "valid", axis=2)
    checks = graph.node("Cast", flags, to=TensorProto.DOUBLE)

    # one product joins the four checks of a sensor and repeats the result in its three columns
    channels = np.kron(np.eye(spec.n_sensors), np.ones((3, 3)))
    valid = np.kron(np.eye(spec.n_sensors), np.ones((1, 3)))
    quarters = np.concatenate([channels, valid]) / 4.0
    return graph.node("MatMul", checks, quarters)


def _tables(spec: StepSpec) -> dict[str, FloatArray]:
    """[rows, last place + 2] by name: what a sensor is next, by its place: an entry if this sample
    is bad, the entry behind it if it is good, so a place is an even number.

    adds: to the count of the hand. The others are as in GuardOutputs.
    """
    bridged = spec.gap_samples + 1
    number = np.arange(1 + bridged * spec.settle_samples)
    # the inverse of number = bridged x delivered - lost
    delivered = -(-number // bridged)
    lost = -number % bridged

    is_lost = (number == 0) | (lost + 1 == bridged)
    after_bad = np.where(is_lost, 0, number - 1)
    after_good = bridged * np.minimum(delivered + 1, spec.settle_samples)
    after = np.stack([after_bad, after_good], axis=1).ravel()

    usable = (after == number[-1]).astype(np.float64)
    settled = (after > number[-1] - bridged).astype(np.float64)
    moved = np.stack([0.0 * number, number > 0], axis=1).ravel()
    alive = (after > 0).astype(np.float64)
    # both counts of a hand in one number, as two digits
    _, enough = _counted(spec)
    return {
        "next_place": 2.0 * after[None],
        "alive": alive[None],
        "weight": usable[None] + LEAST_WEIGHT,
        "still": 1.0 - spec.floor_share * usable[None],
        "adds": usable[None] + len(enough) * settled[None],
        # rows MOVED and USABLE
        "factors": np.stack([moved, usable]),
    }


def _side_digits(spec: StepSpec) -> FloatArray:
    """[S]: what a sensor adds to a count of sensors, which has one digit for each side."""
    of_thumb = side_matrix(spec)[:, 0]
    return np.where(of_thumb > 0.0, 1.0, 1.0 + of_thumb.sum())


def _counted(spec: StepSpec) -> tuple[npt.NDArray[np.int32], BoolArray]:
    """[counts] of a count: how many sensors these are, and whether they are enough."""
    digits = _side_digits(spec)
    base = int((digits == 1.0).sum()) + 1
    opposing, of_thumb = divmod(np.arange(int(digits.sum()) + 1), base)
    enough = of_thumb + opposing >= spec.min_valid_sensors
    if spec.is_pooled:
        # sensors that all lie on one side count for both
        is_one_sided = base > spec.n_sensors
        enough &= (of_thumb > 0) & ((opposing > 0) | is_one_sided)
    return (of_thumb + opposing).astype(np.int32), enough


def by_count(spec: StepSpec, if_known: float, if_unknown: float) -> FloatArray:
    """[counts]: a number for each count of a hand, by whether enough sensors are usable."""
    _, enough = _counted(spec)
    return np.tile(np.where(enough, if_known, if_unknown), len(enough))


def _publish(graph: GraphBuilder, spec: StepSpec, flags: str) -> str:
    """Publish what is known of the hand; returns its count. flags [B, 1, C]: what sensors add."""
    n_sensors, enough = _counted(spec)
    first_channels = np.kron(_side_digits(spec), [1.0, 0.0, 0.0])
    total = graph.node("MatMul", flags, first_channels[:, None])
    count = graph.node("Cast", total, to=TensorProto.INT64)

    # the first digit is of usable sensors, the second of settled ones
    of_hand = graph.reshape(count, -1)
    graph.node("Gather", np.repeat(enough, len(enough)), of_hand, out="settled")
    graph.node("Gather", np.tile(~enough, len(enough)), of_hand, out="unknown")
    usable = np.tile(n_sensors, len(enough))
    graph.node("Gather", usable, of_hand, out="usable_sensors")
    graph.output("settled", TensorProto.BOOL)
    graph.output("unknown", TensorProto.BOOL)
    graph.output("usable_sensors", TensorProto.INT32)
    return count


def reference_flags(
    values: FloatArray, valid: BoolArray, spec: StepSpec
) -> dict[str, npt.NDArray[Any]]:
    """settled, unknown and usable_sensors [T] by the guard's rule in plain Python, from fresh."""
    good, delivered = _reference_sensors(values, valid, spec)
    settled = delivered >= spec.settle_samples
    usable = good & settled
    return {
        "settled": _reference_enough(settled, spec),
        "unknown": ~_reference_enough(usable, spec),
        "usable_sensors": usable.sum(axis=1),
    }


def _reference_enough(usable: BoolArray, spec: StepSpec) -> BoolArray:
    """[T] whether these sensors [T, S] are enough, with pooled features one on each side."""
    enough: BoolArray = usable.sum(axis=1) >= spec.min_valid_sensors
    if spec.is_pooled:
        for side in side_matrix(spec).T:
            enough = enough & usable[:, side > 0.0].any(axis=1)

    return enough


def _reference_sensors(
    values: FloatArray, valid: BoolArray, spec: StepSpec
) -> tuple[BoolArray, npt.NDArray[np.int64]]:
    """Good [T, S], and how many samples each sensor has delivered, [T, S]."""
    triples = values.reshape(len(values), -1, 3)
    in_range = (np.abs(triples) < RANGE_LIMIT[spec.unit]).all(axis=2)
    good = valid & in_range

    delivered = np.zeros(spec.n_sensors, int)
    lost = np.zeros(spec.n_sensors, int)
    history = []
    # in plain counters, another form than the graph's table, so that one checks the other
    for now in good:
        # a lost sample that is bridged does not count, and does not set the count back
        lost = np.where(now, 0, lost + 1)
        bridged = np.where(lost > spec.gap_samples, 0, delivered)
        delivered = np.where(now, delivered + 1, bridged)
        history.append(delivered)

    return good, np.array(history)


def reference_contact(
    values: FloatArray, valid: BoolArray, spec: StepSpec, rule: ContactRule
) -> tuple[BoolArray, FloatArray]:
    """Empty [T] and the zero after each sample [T, C] by the rule in plain Python, from fresh."""
    good, delivered = _reference_sensors(values, valid, spec)
    usable = good & (delivered >= spec.settle_samples)
    unknown = ~_reference_enough(usable, spec)

    share = 1.0 - math.exp(-1.0 / (rule.mean_s * spec.rate_hz))
    most = rule.zero_per_s / spec.rate_hz
    last, mean, zero = np.zeros((3, spec.n_channels))
    # a sensor that was lost for too long begins again one sample after its return
    begun = np.zeros(spec.n_channels, np.bool_)
    empty = False
    empties, zeros = [], []
    for t, now in enumerate(values):
        last = np.where(np.repeat(good[t], 3), now - zero, last)
        held = np.where(begun, mean, 0.0)
        moved = held + share * (np.where(begun, last, 0.0) - held)
        mean = np.where(np.repeat(good[t], 3), moved, mean)
        begun = np.repeat(delivered[t] > 0, 3)

        # in doubt the hand touches something
        counted = np.where(np.repeat(usable[t], 3), mean, 0.0)
        force = math.sqrt((counted**2).sum())
        empty = not unknown[t] and force < (rule.on if empty else rule.off)
        if empty:
            step = counted / (rule.zero_s * spec.rate_hz)
            zero = zero + np.clip(step, -most, most)
        empties.append(empty)
        zeros.append(zero)

    return np.array(empties), np.array(zeros)


def hysteresis(rule: ContactRule) -> float:
    """By how much an empty hand may exceed one that touches something, in squares of the unit."""
    return rule.on**2 - rule.off**2


def add_contact(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, means: list[str]
) -> str:
    """Add the contact rule, publish `empty` [B, 1] bool and return it; "" without the rule.

    means: of the bank, 0 where a sensor is not usable: its last reading must not hold on. Their
    squared length is compared with `on` where the hand was empty, else with `off`.
    """
    rule = spec.contact
    if rule is None:
        return ""
    mean, pull = means

    # In units of the hysteresis, an empty hand may read 1 more than one that touches something. A
    # sum costs less than a choice of two thresholds.
    was_empty = graph.state("empty", 1)
    squares = graph.node("Mul", mean, mean)
    total = graph.node("MatMul", squares, np.ones((spec.n_channels, 1)))
    # In doubt the hand touches something: so the zero stands still while the state is unknown, and
    # the first known sample is compared with `off`.
    off = by_count(spec, rule.off**2 / hysteresis(rule), -np.inf)
    above_off = graph.node("Sub", total, graph.node("Gather", off, guarded.count))
    empty = graph.node("Greater", was_empty, above_off)
    flag = graph.node("Cast", empty, to=TensorProto.DOUBLE)
    graph.keep("empty", flag)

    # Limited in speed: a touch outruns the zero, drift does not.
    most = rule.zero_per_s / spec.rate_hz
    step = graph.node("Clip", pull, -most, most)
    taken = graph.node("Mul", step, flag)
    graph.keep("zero", graph.node("Add", guarded.zero, taken))

    # the flag is the same in all channels
    first = graph.constant(0, np.int64)
    graph.node("Gather", empty, first, out=EMPTY, axis=2)
    graph.output(EMPTY, TensorProto.BOOL, 1)
    return EMPTY
