"""The input guard: the rest of the graph gets finite values in range, and flags for missing ones.

A sample of a sensor is good if the driver marks it as valid and all three channels are finite and
in range. A bad one is replaced by the last good one, and the sensor's filter state is held. NaN
cannot pass: every comparison with NaN is false.

The history of a sensor is one number, its place, stepped by a table (`_next_places`):

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
from holdfast.export.builder import GraphBuilder
from holdfast.export.pooled import side_matrix
from holdfast.export.spec import RANGE_LIMIT, ContactRule, StepSpec


@dataclass(frozen=True)
class GuardOutputs:
    """Names of the guarded tensors, each [B, 1, C] but the past.

    now, last: this and the previous good sample. past: all samples before this one, in parts
    [B, rows, C], oldest first. good: bool, delivered now. begun: 1.0, or 0.0 where the sensor has
    no past. usable: bool. known: [B, 1, 1] bool, enough sensors are usable. zero: what was taken
    from the sample; "" where force does not decide. counted: usable as 1.0 or 0.0 where features
    are pooled and not every sensor is needed, else "".
    """

    now: str
    last: str
    past: tuple[str, ...]
    good: str
    begun: str
    usable: str
    known: str
    zero: str
    counted: str


def add_guard(graph: GraphBuilder, spec: StepSpec) -> GuardOutputs:
    """Add the guard; publishes settled [B], unknown [B] and usable_sensors [B]."""
    oldest = graph.state("oldest", 1)
    older = graph.state("older", spec.history_samples - 2)
    last = graph.state("last", 1)
    place = graph.state("place", 1)

    # the share is a sum of quarters, so a whole one is exactly 1
    share = _share_of_good(graph, spec)
    good = graph.node("GreaterOrEqual", share, 1.0)
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
    begun = graph.node("Min", place, 1.0)

    # The cast rounds a share below 1 down. One look-up costs less than the comparisons and
    # choices of two counters, and no number of samples overflows it.
    even_or_odd = graph.node("Add", place, share)
    entry = graph.node("Cast", even_or_odd, to=TensorProto.INT64)
    following = graph.node("Gather", _next_places(spec), entry)
    graph.keep("place", following)

    counted = ""
    if spec.is_pooled and spec.min_valid_sensors < spec.n_sensors:
        usable, known, counted = _publish_by_side(graph, spec, following)
    else:
        usable, known = _publish(graph, spec, following)
    graph.output("settled", TensorProto.BOOL)
    graph.output("unknown", TensorProto.BOOL)
    graph.output("usable_sensors", TensorProto.INT32)
    past = (oldest, older, last)
    return GuardOutputs(now, last, past, good, begun, usable, known, zero, counted)


def _share_of_good(graph: GraphBuilder, spec: StepSpec) -> str:
    """[B, 1, C]: good quarters of a sensor: three channels in range, and the valid flag."""
    magnitude = graph.node("Abs", "sample")
    in_range = graph.node("Less", magnitude, RANGE_LIMIT[spec.unit])
    flags = graph.node("Concat", in_range, "valid", axis=2)
    checks = graph.node("Cast", flags, to=TensorProto.DOUBLE)

    # one product joins the four checks of a sensor and repeats the result in its three columns
    channels = np.kron(np.eye(spec.n_sensors), np.ones((3, 3)))
    valid = np.kron(np.eye(spec.n_sensors), np.ones((1, 3)))
    quarters = np.concatenate([channels, valid]) / 4.0
    return graph.node("MatMul", checks, quarters)


def _next_places(spec: StepSpec) -> FloatArray:
    """[last place + 2] next places: entry `place` if this sample is bad, `place + 1` if good.

    So that both entries of a place fit into one table, a place is an even number.
    """
    bridged = spec.gap_samples + 1
    number = np.arange(1 + bridged * spec.settle_samples)
    # the inverse of number = bridged x delivered - lost
    delivered = -(-number // bridged)
    lost = -number % bridged

    is_lost = (number == 0) | (lost + 1 == bridged)
    after_bad = np.where(is_lost, 0, number - 1)
    after_good = bridged * np.minimum(delivered + 1, spec.settle_samples)
    return 2.0 * np.stack([after_bad, after_good], axis=1).ravel()


def _publish(graph: GraphBuilder, spec: StepSpec, place: str) -> tuple[str, str]:
    """Publish the flags; returns usable [B, 1, C] and known [B, 1, 1], bool."""
    last_place, first_settled = _settled_places(spec)

    # places are whole: above the place before is at the place itself
    usable = graph.node("Greater", place, last_place - 1.0)
    n_usable = _count(graph, usable)
    graph.node("Div", n_usable, np.int32(3), out="usable_sensors")

    if spec.min_valid_sensors == spec.n_sensors:
        # where every sensor is needed, the worst one decides, and nothing is counted
        worst = graph.node("ReduceMin", place, [1, 2], keepdims=1)
        known = graph.node("Greater", worst, last_place - 1.0)
        of_hand = graph.reshape(worst, -1)
        graph.node("Greater", of_hand, first_settled - 1.0, out="settled")
        graph.node("Less", of_hand, float(last_place), out="unknown")
    else:
        needed = graph.constant(3 * spec.min_valid_sensors, np.int32)
        settled = graph.node("Greater", place, first_settled - 1.0)
        n_settled = _count(graph, settled)
        graph.node("GreaterOrEqual", n_settled, needed, out="settled")
        graph.node("Less", n_usable, needed, out="unknown")
        enough = graph.node("GreaterOrEqual", n_usable, needed)
        known = graph.reshape(enough, -1, 1, 1)

    return usable, known


def _settled_places(spec: StepSpec) -> tuple[int, int]:
    """The place of a sensor that is usable, and the lowest one of a sensor that is settled."""
    a_delivery = 2 * (spec.gap_samples + 1)
    last_place = a_delivery * spec.settle_samples
    return last_place, last_place - a_delivery + 2


def _publish_by_side(
    graph: GraphBuilder, spec: StepSpec, place: str
) -> tuple[str, str, str]:
    """Publish the flags where each side needs a sensor; returns usable, known and counted."""
    last_place, first_settled = _settled_places(spec)
    # two rows: usable now, and settled
    above = np.array([[last_place - 1.0], [first_settled - 1.0]])
    flags = graph.node("Greater", place, above)
    numbers = graph.node("Cast", flags, to=TensorProto.DOUBLE)

    # of all sensors, and of each side
    sides = side_matrix(spec)
    members = np.hstack([np.ones((spec.n_sensors, 1)), sides])
    counts = graph.node("MatMul", numbers, np.kron(members, [[1.0], [0.0], [0.0]]))
    needed = np.array([spec.min_valid_sensors, 1, 1], dtype=np.float64)
    enough = graph.node("GreaterOrEqual", counts, needed)
    both = graph.node("ReduceMin", enough, [2], keepdims=0)

    first, second = (graph.constant(row, np.int64) for row in range(2))
    graph.node("Gather", both, second, out="settled", axis=1)
    is_known = graph.node("Gather", both, first, axis=1)
    number = graph.node("Cast", is_known, to=TensorProto.INT32)
    graph.node("Less", number, np.int32(1), out="unknown")
    # no side has more sensors than the hand
    usable_counts = graph.node("Gather", counts, first, axis=1)
    most = graph.node("ReduceMax", usable_counts, [1], keepdims=0)
    graph.node("Cast", most, out="usable_sensors", to=TensorProto.INT32)

    usable = graph.columns(flags, 0, 1)
    known = graph.reshape(is_known, -1, 1, 1)
    return usable, known, graph.columns(numbers, 0, 1)


def _count(graph: GraphBuilder, flags: str) -> str:
    """[B, 1, C] bool -> [B] number of channels."""
    # as int32, whose sum is exact and whose division by three is that of whole numbers
    numbers = graph.node("Cast", flags, to=TensorProto.INT32)
    return graph.node("ReduceSum", numbers, [1, 2], keepdims=0)


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


def add_contact(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, means: list[str]
) -> str:
    """Add the contact rule, publish `empty` [B, 1] bool and return it; "" without the rule.

    means: of the bank. The length of the mean is compared with `on` where the hand was empty, with
    `off` where it touched something, as it does in a fresh state.
    """
    rule = spec.contact
    if rule is None:
        return ""
    mean, pull = means
    # a sensor that a degraded hand lacks says nothing; its last reading must not hold on
    if guarded.counted:
        # the mean of a guarded sample is finite, so a product will do, and costs less
        mean = graph.node("Mul", mean, guarded.counted)
        pull = graph.node("Mul", pull, guarded.counted)
    elif spec.min_valid_sensors < spec.n_sensors:
        mean = graph.node("Where", guarded.usable, mean, 0.0)
        pull = graph.node("Where", guarded.usable, pull, 0.0)

    # In units of the hysteresis, a hand that was empty may read 1 more than one that was not. A
    # product and a sum cost less than a choice of two thresholds.
    was_empty = graph.state("empty", 1)
    length = graph.node("ReduceL2", mean, [2], keepdims=1)
    above_off = graph.node("Sub", length, rule.off / (rule.on - rule.off))
    below = graph.node("Less", above_off, was_empty)
    # In doubt the hand touches something: so the zero stands still while the state is unknown, and
    # the first known sample is compared with `off`.
    empty = graph.node("And", below, guarded.known)
    flag = graph.node("Cast", empty, to=TensorProto.DOUBLE)
    graph.keep("empty", flag)

    # Limited in speed: a touch outruns the zero, drift does not.
    most = rule.zero_per_s / spec.rate_hz
    step = graph.node("Clip", pull, -most, most)
    taken = graph.node("Mul", step, flag)
    zero = graph.node("Add", guarded.zero, taken)
    graph.keep("zero", zero)

    # the flag is the same in all channels
    first = graph.constant(0, np.int64)
    graph.node("Gather", empty, first, out=EMPTY, axis=2)
    graph.output(EMPTY, TensorProto.BOOL, 1)
    return EMPTY
