"""Hard cases of filter and features: long runs, large offsets, silence, bad samples, odd rates and
degenerate hands.

Tests marked unguarded take the guard away, in plain scipy or numpy, and watch what happens.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pytest
from hard_marks import (
    BAD_SAMPLE,
    DEAD,
    DEGENERATE,
    FLOATS,
    GAPS,
    LONG,
    NORMAL,
    OFFSET,
    POLE,
    RATES,
    SIGN,
    SILENCE,
    SUBNORMAL,
)
from scipy.signal import sosfilt
from test_bank import bank_model, bank_outputs, by_scipy, forces, spec_at

from holdfast.core.contract import (
    NORMAL_FLOOR,
    RISKY_SLIP,
    FloatArray,
    Prediction,
    Sample,
    Unit,
)
from holdfast.edge_runtime.decision import DecisionRules, DecisionState, decide
from holdfast.edge_runtime.graph import StepGraph, open_session, run_recording
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.edge_runtime.preparation import Preparation
from holdfast.export.detectors import LOW_PASS_HZ, detector_names, sections
from holdfast.export.features import feature_graph
from holdfast.export.spec import BANDS_HZ, NOISE_RMS, RANGE_LIMIT, StepSpec
from holdfast.training.critical_points import offline_critical_points
from holdfast.training.recording import Recording

if TYPE_CHECKING:
    from conftest import Built

DEFAULT_MODEL = Path(__file__).resolve().parents[2] / "models" / "holdfast-150hz.onnx"
TINY = np.finfo(np.float64).tiny
RATE_HZ = 150.0
CHUNK, TENTH = 20_000, 100_000
LongArray = npt.NDArray[np.longdouble]
Record = Any
"""pytest's record_property."""


def cascade(rate_hz: float, band_hz: float) -> FloatArray:
    """The bank's filter [4, 6] as it is written down: differentiator, resonator twice, low-pass."""
    k, low = 2.0 * rate_hz, 2.0 * np.pi * LOW_PASS_HZ
    resonators = sections(rate_hz, band_hz)[1:]
    last = [low / (k + low), low / (k + low), 0.0, 1.0, (low - k) / (k + low), 0.0]
    return np.array([[k, -k, 0.0, 1.0, 1.0, 0.0], *resonators, last])


def exact(sos: FloatArray, x: npt.NDArray[Any]) -> LongArray:
    """The filter's output [T] with 64-bit mantissas, from rest at the first value."""
    return np.asarray(
        sosfilt(
            sos.astype(np.longdouble), x.astype(np.longdouble) - np.longdouble(x[0])
        )
    )


def off(got: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """Largest error over the largest output."""
    return float(np.abs(got - expected).max() / np.abs(expected).max())


def tone(seconds: float, rate_hz: float, hz: float = 20.0) -> FloatArray:
    return np.sin(2.0 * np.pi * hz * np.arange(round(seconds * rate_hz)) / rate_hz)


# The pole, and length


@POLE.unguarded
def test_the_differentiator_on_its_own_answers_one_knock_for_ever(
    record_property: Record,
) -> None:
    k = 2.0 * RATE_HZ
    knock = np.zeros(10**6)
    knock[0] = 1.0
    out = sosfilt([[k, -k, 0.0, 1.0, 1.0, 0.0]], knock)
    record_property(
        "amplitude_after_a_million_samples_over_the_first",
        float(abs(out[-1]) / abs(out[1])),
    )
    assert abs(out[-1]) == abs(out[1])
    assert np.abs(sosfilt(sections(RATE_HZ, 20.0), knock)[-1000:]).max() < TINY


def chunks(steps: int, offset: float = 1e4) -> Iterator[FloatArray]:
    """[CHUNK, 3] again and again: noise on an offset, with a knock now and then."""
    for number in range(steps // CHUNK):
        rng = np.random.default_rng([5, number])
        noise = rng.normal(0.0, 4.0, (CHUNK, 3))
        yield offset + noise + 100.0 * (rng.random((CHUNK, 1)) < 1e-3)


@pytest.mark.parametrize(
    "steps", [100_000, pytest.param(10**8, marks=pytest.mark.soak)]
)
@LONG.mark
def test_the_bank_is_no_further_from_the_exact_filter_at_the_end_than_at_the_beginning(
    steps: int, record_property: Record
) -> None:
    spec = spec_at(RATE_HZ, n_sensors=1)
    graph = StepGraph(open_session(bank_model(spec)))
    memory: list[LongArray] = [
        np.zeros((3, 2, 2), dtype=np.longdouble) for _ in BANDS_HZ
    ]
    errors, states, first = [], [], None
    got = np.empty((CHUNK, 2, len(BANDS_HZ)))
    for values in chunks(steps):
        first = values[0, :2] if first is None else first
        for row in range(CHUNK):
            graph.sample[0] = values[row]
            got[row] = graph.step()["rectified"][0].reshape(-1, 3).T[:2]
        rest = values[:, :2].astype(np.longdouble) - first.astype(np.longdouble)
        for band, hz in enumerate(BANDS_HZ):
            expected, memory[band] = sosfilt(
                sections(RATE_HZ, hz).astype(np.longdouble),
                rest,
                axis=0,
                zi=memory[band],
            )
            errors.append(off(got[:, :, band], np.abs(expected)))
        states.append(float(np.abs(graph.state).max()))
    by_chunk = np.array(errors).reshape(-1, len(BANDS_HZ)).max(axis=1)
    record_property("samples", steps)
    tenth = max(1, len(by_chunk) // 10)
    record_property("largest_error_of_the_first_tenth", float(by_chunk[:tenth].max()))
    record_property("largest_error_of_the_last_tenth", float(by_chunk[-tenth:].max()))
    assert by_chunk.max() < 1e-14
    assert (
        max(states) < 1e5
    )  # ten times the offset, which is part of the state as the last reading


@LONG.unguarded
def test_a_cascade_drifts_away_from_the_exact_filter(record_property: Record) -> None:
    x = np.random.default_rng(1).normal(7.0, 1.0, 10**6).astype(np.float32)
    errors = {}
    for name, sos in (
        ("cascade", cascade(RATE_HZ, 20.0)),
        ("ours", sections(RATE_HZ, 20.0)),
    ):
        expected = exact(sos, x)
        got = sosfilt(sos.astype(np.float32), x - x[0])
        assert got.dtype == np.float32
        errors[name] = [
            off(got[part], expected[part]) for part in (np.s_[:TENTH], np.s_[-TENTH:])
        ]
        record_property(
            f"{name}_in_float32_first_and_last_tenth",
            " and ".join(f"{e:.2g}" for e in errors[name]),
        )
    assert errors["cascade"][1] > 3.0 * errors["cascade"][0]
    assert errors["cascade"][1] > 30.0 * errors["ours"][1]
    assert errors["ours"][1] < 2.0 * errors["ours"][0]


# Offset


@pytest.mark.parametrize("sign", [1.0, -1.0])
@OFFSET.mark
def test_a_slip_ten_thousand_times_smaller_than_its_offset_is_seen_as_without_it(
    sign: float, record_property: Record
) -> None:
    slip, offset = 40.0, sign * 4e5
    values = np.random.default_rng(0).normal(0.0, NOISE_RMS["count"], (900, 6))
    values[600:660, 0] += slip * tone(0.4, RATE_HZ)
    fired, without = (fires(values + lift, "count") for lift in (offset, 0.0))
    record_property("offset_over_slip", abs(offset) / slip)
    assert not fired[:600].any()
    assert fired[600:660].any()
    np.testing.assert_array_equal(fired, without)
    apart = np.abs(
        bank_outputs(spec_at(RATE_HZ), values + offset)
        - bank_outputs(spec_at(RATE_HZ), values)
    ).max()
    largest = bank_outputs(spec_at(RATE_HZ), values).max()
    record_property("what_the_offset_changes_over_the_slip", float(apart / largest))
    assert apart < 1e-9 * largest


@cache
def step_of(
    unit: Unit, *groups: str, n_sensors: int = 2, rate_hz: float = RATE_HZ
) -> Any:
    return open_session(
        feature_graph(StepSpec(n_sensors, rate_hz, unit, groups)).SerializeToString()
    )


def fires(values: FloatArray, unit: Unit) -> npt.NDArray[np.bool_]:
    """[T] whether the band-pass detector fires."""
    valid = np.ones((len(values), 2), dtype=np.bool_)
    column = detector_names(StepSpec(2, RATE_HZ, unit, ("now",))).index("band_pass")
    detectors: npt.NDArray[np.bool_] = run_recording(
        step_of(unit, "now"), values, valid, ["detectors"]
    )["detectors"]
    return detectors[:, column]


@OFFSET.unguarded
def test_started_at_zero_the_offset_rings_louder_than_the_slip_a_second_later(
    record_property: Record,
) -> None:
    slip = np.concatenate([np.zeros(150), tone(0.4, RATE_HZ), np.zeros(90)])
    passed = np.abs(sosfilt(sections(RATE_HZ, 20.0), slip)).max()
    ringing = np.abs(sosfilt(sections(RATE_HZ, 10.0), np.full(300, 1e4))[150:]).max()
    record_property(
        "offset_ringing_a_second_later_over_the_slip", float(ringing / passed)
    )
    assert ringing > passed


# Silence and subnormal numbers


@SILENCE.mark
def test_ten_minutes_of_silence_leave_next_to_nothing_and_no_subnormal_number(
    record_property: Record,
) -> None:
    spec = spec_at(RATE_HZ, n_sensors=6)
    graph = StepGraph(open_session(bank_model(spec)))
    loud = np.random.default_rng(0).normal(0.0, 1000.0, (3000, spec.n_channels))
    with_signal = step_us(graph, loud)
    minutes = silent_minutes(graph, loud[-1:])
    record_property(
        "cost_on_silence_over_cost_on_signal",
        float(np.median(minutes[-1]) / np.median(with_signal)),
    )
    assert graph.out["rectified"].max() < 1e-50
    assert not subnormal(graph.state).any()


def silent_minutes(graph: StepGraph, held: FloatArray) -> list[FloatArray]:
    """Microseconds of every step in ten minutes of one sample.

    Where a step leaves the state as it was, all later ones would too: the rest is left out.
    """
    minutes = []
    for _ in range(10):
        minutes.append(step_us(graph, np.repeat(held, round(60 * RATE_HZ), axis=0)))
        before = graph.state.tobytes()
        graph.step()
        if graph.state.tobytes() == before:
            break
    return minutes


def step_us(graph: StepGraph, values: FloatArray) -> FloatArray:
    """Microseconds of every step; on the way no state is ever subnormal."""
    took = np.empty(len(values))
    for row, sample in enumerate(values):
        graph.sample[0] = sample
        begin_ns = time.thread_time_ns()
        graph.step()
        took[row] = 1e-3 * (time.thread_time_ns() - begin_ns)
        if row % 100 == 0:
            assert not subnormal(graph.state).any()
    return took


def subnormal(numbers: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    return (numbers != 0.0) & (np.abs(numbers) < TINY)


@SILENCE.unguarded
def test_a_plain_filter_is_still_busy_with_subnormal_numbers_ten_minutes_later(
    record_property: Record,
) -> None:
    sos = sections(RATE_HZ, 20.0)
    _, memory = sosfilt(sos, tone(1.0, RATE_HZ), zi=np.zeros((3, 2)))
    for _ in range(10):
        out, memory = sosfilt(sos, np.zeros(round(60 * RATE_HZ)), zi=memory)
    assert subnormal(memory).any()
    assert subnormal(out).all()
    silence = np.zeros(200_000)
    times = []
    for state in (memory, np.zeros_like(memory)):
        took = []
        # of this thread, the least of five: other work on the machine is none of the filter's
        for _ in range(5):
            begin_ns = time.thread_time_ns()
            sosfilt(sos, silence, zi=state)
            took.append(time.thread_time_ns() - begin_ns)
        times.append(min(took))
    record_property("cost_on_subnormal_numbers_over_cost_on_zeros", times[0] / times[1])


@pytest.mark.parametrize("size", [5e-324, 1e-310, 2e-308])
@SUBNORMAL.mark
def test_subnormal_readings_are_silence_to_bank_features_and_detectors(
    size: float,
) -> None:
    rng = np.random.default_rng(0)
    values = size * rng.choice([-1.0, 0.0, 1.0], size=(120, 6))
    assert not bank_outputs(spec_at(RATE_HZ), values)[1:].max() > 1e-90
    valid = np.ones((120, 2), dtype=np.bool_)
    out = run_recording(
        step_of("N", "now", "bands", "activity"),
        values,
        valid,
        ["features", "detectors"],
    )
    assert not out["features"].any()
    assert not out["detectors"].any()


@SUBNORMAL.unguarded
def test_a_plain_filter_answers_subnormal_readings_with_subnormal_numbers() -> None:
    out, memory = sosfilt(
        sections(RATE_HZ, 20.0), 1e-310 * tone(1.0, RATE_HZ), zi=np.zeros((3, 2))
    )
    assert subnormal(out).any()
    assert subnormal(memory).any()


# Bad samples


BAD_READINGS: Mapping[str, float] = {
    "NaN": np.nan,
    "inf": np.inf,
    "1e30": 1e30,
    "saturated": RANGE_LIMIT["N"],
}


@cache
def opened(path: Path) -> Model:
    return Model(path)


def grip(length: int, seed: int = 0) -> FloatArray:
    """[T, 18] a noisy hand that has closed on something."""
    rng = np.random.default_rng(seed)
    return np.tile([0.2, -0.1, 2.0], (length, 6)) + rng.normal(
        0.0, NOISE_RMS["N"], (length, 18)
    )


def answers(
    path: Path,
    values: FloatArray,
    *,
    invalid: tuple[tuple[int, int], ...] = (),
    t_s: FloatArray | None = None,
) -> list[Prediction]:
    """Samples of the hand; invalid: (row, finger) that the driver calls so; t_s: time stamps,
    regular by default."""
    model = opened(path)
    monitor = GripMonitor(model, None)
    valid = np.ones((len(values), 6), dtype=np.bool_)
    for row, finger in invalid:
        valid[row, finger] = False
    stamps = np.arange(len(values)) / model.card.rate_hz if t_s is None else t_s
    stamps_ns = np.round(1e9 * (1.0 + stamps)).astype(np.int64).tolist()
    samples = zip(stamps_ns, values, valid, strict=True)
    return [
        monitor.feed(Sample(t, row, ok, k)) for k, (t, row, ok) in enumerate(samples)
    ]


def fields_of(one: Prediction) -> tuple[Any, ...]:
    """Everything but the times."""
    return (
        one.state,
        one.p_situation,
        one.p_class,
        one.detectors,
        one.arm,
        one.act,
        one.settled,
        one.degraded,
    )


@pytest.mark.parametrize("how", [*BAD_READINGS, "invalid", "stuck and found so"])
@BAD_SAMPLE.mark
def test_one_bad_sample_is_unknown_for_itself_alone_and_the_hand_stays_settled(
    eight_classes: Built, how: str
) -> None:
    values, row, finger = grip(60), 40, 2
    invalid: tuple[tuple[int, int], ...] = ()
    if how in BAD_READINGS:
        values[row, 3 * finger + 1] = BAD_READINGS[how]
    else:
        values[row, 3 * finger : 3 * finger + 3] = values[
            row - 1, 3 * finger : 3 * finger + 3
        ]
        invalid = ((row, finger),)
    predictions = answers(eight_classes.model, values, invalid=invalid)
    settle = opened(eight_classes.model).card.settle_samples
    assert [k for k, one in enumerate(predictions) if one.state == "unknown"] == [
        *range(settle - 1),
        row,
    ]
    assert all(one.settled for one in predictions[settle - 1 :])
    assert all(np.isfinite(list(one.p_situation.values())).all() for one in predictions)


@BAD_SAMPLE.mark
def test_a_sample_that_comes_twice_is_answered_twice_and_counted_once(
    eight_classes: Built,
) -> None:
    values = grip(60)
    once = answers(eight_classes.model, values)
    twice = np.repeat(np.arange(60), np.where(np.arange(60) == 40, 3, 1))
    monitor = GripMonitor(opened(eight_classes.model), None)
    predictions = [
        monitor.feed(Sample(k * 20_000_000, values[k], np.ones(6, np.bool_), k))
        for k in twice.tolist()
    ]
    assert [fields_of(one) for one in predictions] == [
        fields_of(once[k]) for k in twice.tolist()
    ]


@BAD_SAMPLE.mark
def test_a_repeated_risky_sample_requests_no_act_and_an_override_beside_it_counts(
    eight_classes: Built,
) -> None:
    """The hand acts on two risky samples in a row, not on one that came twice."""
    pulled = next(r for r in eight_classes.data.recordings if r.action == "pull")
    monitor = GripMonitor(opened(eight_classes.model), None)
    for k, row in enumerate(pulled.samples):
        sample = Sample(k * 20_000_000, row, np.ones(6, np.bool_), k)
        before, again = monitor.feed(sample), [monitor.feed(sample) for _ in range(5)]
        assert all(fields_of(one) == fields_of(before) for one in again)
        if before.act:
            break
    assert before.act
    assert not monitor.feed(sample, override=True).act


@BAD_SAMPLE.unguarded
def test_a_repeated_risky_sample_counted_twice_would_be_a_request_to_act() -> None:
    rules, state = DecisionRules(), DecisionState()
    once = decide(rules, state, RISKY_SLIP, 900, period_us=6667)
    assert not once.act
    assert decide(rules, once, RISKY_SLIP, 900, period_us=6667).act


@BAD_SAMPLE.unguarded
def test_a_plain_filter_never_gets_over_a_nan_and_takes_thousands_of_samples_over_1e30(
    record_property: Record,
) -> None:
    sos, clean = sections(RATE_HZ, 10.0), tone(60.0, RATE_HZ)
    for bad in (np.nan, np.inf):
        spoilt = clean.copy()
        spoilt[100] = bad
        with np.errstate(invalid="ignore"):
            assert np.isnan(sosfilt(sos, spoilt)[101:]).all()
    spoilt[100] = 1e30
    wrong = (
        np.abs(sosfilt(sos, spoilt) - sosfilt(sos, clean))
        > 0.1 * np.abs(sosfilt(sos, clean)).max()
    )
    record_property(
        "samples_until_1e30_has_faded", int(np.flatnonzero(wrong)[-1] - 100)
    )
    assert np.flatnonzero(wrong)[-1] > 1100


# Time


@pytest.mark.parametrize("share", [0.1, 0.45])
@GAPS.mark
def test_a_late_or_early_sample_changes_no_bit_of_any_answer(
    eight_classes: Built, share: float
) -> None:
    values = grip(80)
    late = share * np.random.default_rng(1).uniform(-1.0, 1.0, 80) / 50.0
    late[1:] = np.where(np.diff(late) * 50.0 > 0.49, 0.0, late[1:])
    jittered = answers(
        eight_classes.model, values, t_s=np.arange(80) / 50.0 + 0.5 * late
    )
    assert [fields_of(one) for one in jittered] == [
        fields_of(one) for one in answers(eight_classes.model, values)
    ]


@pytest.mark.parametrize("lost", [1, 2, 9])
@GAPS.mark
def test_samples_that_were_dropped_are_answered_like_samples_called_invalid(
    eight_classes: Built, lost: int
) -> None:
    values, first = grip(90), 45
    gone = range(first, first + lost)
    kept = [k for k in range(90) if k not in gone]
    dropped = answers(eight_classes.model, values[kept], t_s=np.array(kept) / 50.0)
    invalid = answers(
        eight_classes.model,
        values,
        invalid=tuple((k, finger) for k in gone for finger in range(6)),
    )
    assert [one.state for one in dropped] == [invalid[k].state for k in kept]
    known = [k for k, one in enumerate(dropped) if one.state != "unknown"]
    assert [fields_of(dropped[k]) for k in known] == [
        fields_of(invalid[kept[k]]) for k in known
    ]
    assert (dropped[first].state == "unknown") == (
        lost > opened(eight_classes.model).card.gap_samples
    )


@GAPS.unguarded
def test_glued_together_over_a_gap_a_slow_change_of_grip_rings_like_a_slip(
    record_property: Record,
) -> None:
    t_s = np.arange(600) / RATE_HZ
    slow = 5.0 * np.sin(2.0 * np.pi * 0.25 * t_s)
    glued = np.delete(slow, np.s_[300:330])
    sos = sections(RATE_HZ, 20.0)
    whole, jumped = (np.abs(sosfilt(sos, x - x[0])[200:]).max() for x in (slow, glued))
    record_property(
        "loudness_over_the_gap_over_loudness_without", float(jumped / whole)
    )
    assert jumped > 10.0 * whole


# Rates and widths


@pytest.mark.parametrize(
    "rate_hz", [40.0, 43.5, 54.4, 65.3, 119.5, 120.0, 1000.0, 10_000.0]
)
@RATES.mark
def test_at_rates_where_a_band_lies_on_the_edge_the_bank_is_the_exact_filter(
    rate_hz: float, record_property: Record
) -> None:
    spec = spec_at(rate_hz, n_sensors=1)
    values = forces(max(200, round(rate_hz)), 3)
    got = bank_outputs(spec, values)
    bands = spec.usable_bands()
    edge = bands[-1] / rate_hz
    error = max(
        off(
            got[:, 0, axis, place],
            np.abs(exact(sections(rate_hz, band), values[:, axis])),
        )
        for axis in range(2)
        for place, band in enumerate(bands)
    )
    record_property("highest_band_over_the_rate", edge)
    record_property("largest_error", error)
    assert edge < 0.46
    assert error < 1e-9


@RATES.unguarded
def test_a_band_kept_next_to_half_the_rate_rings_for_half_a_minute(
    record_property: Record,
) -> None:
    poles = np.abs(np.roots(sections(50.1, 25.0)[1, 3:]))
    rings_s = float(-1.0 / (50.1 * np.log(poles.max())))
    record_property("time_constant_s", rings_s)
    assert rings_s > 30.0
    assert 25.0 not in spec_at(50.1).usable_bands()


@FLOATS.mark
def test_sample_and_state_are_float64_and_the_features_of_a_forest_float32() -> None:
    session = step_of("N", "now")
    types = {
        tensor.name: tensor.type
        for tensor in (*session.get_inputs(), *session.get_outputs())
    }
    assert (types["sample"], types["state"], types["state_out"]) == (
        "tensor(double)",
    ) * 3
    assert types["features"] == "tensor(float)"


@FLOATS.mark
def test_readings_that_came_as_float32_are_answered_as_the_same_numbers_in_float64() -> (
    None
):
    narrow: Any = forces(300, 6).astype(np.float32)
    valid = np.ones((300, 2), dtype=np.bool_)
    one, other = (
        run_recording(step_of("N", "now", "bands"), values, valid, ["features"])[
            "features"
        ]
        for values in (narrow, narrow.astype(np.float64))
    )
    assert one.tobytes() == other.tobytes()


@FLOATS.unguarded
def test_with_float32_state_the_lowest_band_is_right_at_150_hz_and_wrong_at_10_khz(
    record_property: Record,
) -> None:
    errors = {}
    for rate_hz in (150.0, 10_000.0):
        x = forces(round(2 * rate_hz), 1)[:, 0].astype(np.float32)
        sos = sections(rate_hz, 10.0)
        errors[rate_hz] = off(sosfilt(sos.astype(np.float32), x - x[0]), exact(sos, x))
        record_property(f"float32_error_at_{rate_hz:g}_hz", errors[rate_hz])
        assert off(sosfilt(sos, x.astype(np.float64) - x[0]), exact(sos, x)) < 1e-9
    assert errors[150.0] < 1e-5
    assert errors[10_000.0] > 0.01


# Forces no hand should have


@pytest.mark.parametrize("normal", [0.0, -0.0, 1e-300, -1.0, -50.0])
@NORMAL.mark
def test_without_a_normal_force_every_ratio_is_taken_over_the_floor(
    normal: float,
) -> None:
    values = np.tile([3.0, -2.0, normal], (120, 2)) + np.outer(
        np.linspace(0.0, 1.0, 120), np.tile([1.0, 1.0, 0.0], 2)
    )
    groups = ("scaled_differences", "scaled_sums", "activity")
    features = run_recording(
        step_of("N", *groups), values, np.ones((120, 2), np.bool_), ["features"]
    )["features"]
    assert np.isfinite(features).all()
    assert np.abs(features[90:]).max() <= np.abs(values).max() * 2 / NORMAL_FLOOR["N"]


@NORMAL.unguarded
def test_a_bare_ratio_is_infinite_at_no_normal_force_and_turns_its_sign_as_it_crosses_zero(
    record_property: Record,
) -> None:
    normal = np.array([1e-3, 1e-9, 0.0, -1e-9])
    with np.errstate(divide="ignore"):
        ratio = 3.0 / normal
    record_property("ratio_at_a_nanonewton", float(ratio[1]))
    assert np.isinf(ratio[2])
    assert np.sign(ratio[1]) != np.sign(ratio[3])


# A dead hand


def noise(length: int, seed: int = 0) -> FloatArray:
    """[T, 18] an empty hand."""
    return np.random.default_rng(seed).normal(0.0, NOISE_RMS["N"], (length, 18))


@pytest.mark.parametrize("reading", [0.0, -0.0, 0.1, 5.0])
@DEAD.mark
def test_a_hand_that_reads_the_same_numbers_from_the_start_is_never_known(
    reading: float,
) -> None:
    predictions = answers(DEFAULT_MODEL, np.full((200, 18), reading))
    assert {one.state for one in predictions} == {"unknown"}
    assert not any(one.act or one.arm or one.degraded for one in predictions)


@DEAD.mark
def test_a_frozen_hand_is_unknown_once_its_history_is_one_reading_and_known_when_it_moves() -> (
    None
):
    values, settle = noise(260), opened(DEFAULT_MODEL).card.settle_samples
    values[100:230] = values[100]
    predictions = answers(DEFAULT_MODEL, values)
    unknown = [k for k, one in enumerate(predictions) if one.state == "unknown"]
    assert unknown == [*range(settle - 1), *range(100 + settle - 1, 230)]


@pytest.mark.parametrize("finger", range(6))
@DEAD.mark
def test_one_finger_dead_from_the_start_makes_no_grasp_of_an_empty_hand(
    finger: int,
) -> None:
    values = noise(160)
    values[:, 3 * finger : 3 * finger + 3] = 0.0
    settle = opened(DEFAULT_MODEL).card.settle_samples
    assert {one.state for one in answers(DEFAULT_MODEL, values)[settle - 1 :]} == {
        "nothing"
    }


@pytest.mark.parametrize(
    ("lost", "known"),
    [([1], True), ([1, 4], True), ([1, 3, 4], False), (range(6), False)],
)
@DEAD.mark
def test_fingers_lost_from_the_start_leave_the_hand_degraded_and_too_many_unknown(
    lost: Iterable[int], known: bool
) -> None:
    values = noise(160).reshape(-1, 6, 3)
    values[:, list(lost)] = np.nan
    settle = opened(DEFAULT_MODEL).card.settle_samples
    later = answers(DEFAULT_MODEL, values.reshape(-1, 18))[settle - 1 :]
    found = {(one.state, one.degraded, one.settled) for one in later}
    assert found == {("nothing", True, True) if known else ("unknown", False, False)}


@DEAD.unguarded
def test_the_forest_itself_calls_a_quieter_hand_than_it_was_trained_on_a_grasp(
    record_property: Record,
) -> None:
    session, valid = opened(DEFAULT_MODEL).session, np.ones((160, 6), dtype=np.bool_)
    for name, factor in (
        ("exact_zeros", 0.0),
        ("a_tenth_of_the_noise", 0.1),
        ("the_usual_noise", 1.0),
    ):
        out = run_recording(
            session, factor * noise(160), valid, ["p_situation", "unknown"]
        )
        assert not out["unknown"][-1]
        record_property(
            f"probability_of_nothing_for_{name}", float(out["p_situation"][-1, 0])
        )
    assert out["p_situation"][-1, 0] > 0.9  # with the usual noise it is right


# Degenerate hands


def recording(samples: FloatArray) -> Recording:
    return Recording(
        "one",
        "one",
        samples,
        np.ones((len(samples), samples.shape[1] // 3), np.bool_),
        RATE_HZ,
        "N",
    )


@DEGENERATE.mark
def test_six_equal_fingers_are_found_slipping_where_one_of_them_is() -> None:
    rng = np.random.default_rng(0)
    one = np.tile([0.0, 0.0, 2.0], (1200, 1)) * (np.arange(1200) > 300)[
        :, None
    ] + rng.normal(0.0, 0.01, (1200, 3))
    one[800:] += [1.5, 0.0, -0.5]
    rows = [point.row for point in offline_critical_points(recording(one))]
    assert rows == [800]
    assert [
        point.row for point in offline_critical_points(recording(np.tile(one, 6)))
    ] == rows


@DEGENERATE.mark
def test_equal_fingers_have_equal_features_and_no_number_that_is_not_finite() -> None:
    one = forces(200, 3)
    session = step_of("N", "now", "bands", n_sensors=6)
    valid = np.ones((200, 6), dtype=np.bool_)
    features = run_recording(session, np.tile(one, 6), valid, ["features"])["features"]
    assert np.isfinite(features).all()
    for first, width in ((0, 3), (18, 20)):
        fingers = features[:, first : first + 6 * width].reshape(200, 6, width)
        np.testing.assert_array_equal(
            fingers, np.broadcast_to(fingers[:, :1], fingers.shape)
        )


@pytest.mark.parametrize("constant", [0.0, 5.0, -5.0, 1e5])
@DEGENERATE.mark
def test_a_trial_in_which_nothing_varies_has_no_critical_point_and_no_warning(
    constant: float,
) -> None:
    assert offline_critical_points(recording(np.full((900, 18), constant))) == []


@DEGENERATE.unguarded
def test_the_first_principal_component_of_a_constant_trial_is_nan_and_its_sign_is_arbitrary() -> (
    None
):
    constant = np.full((900, 6), 5.0)
    with np.errstate(invalid="ignore"):
        scaled = (constant - constant.mean(axis=0)) / constant.std(axis=0)
    assert np.isnan(scaled).all()
    covariance = np.cov(forces(300, 6).T)
    values, vectors = np.linalg.eigh(covariance)
    for first in (vectors[:, -1], -vectors[:, -1]):
        np.testing.assert_allclose(covariance @ first, values[-1] * first)


@SIGN.mark
def test_a_shear_axis_turned_round_changes_no_bit_of_the_bank() -> None:
    values = forces(300, 6)
    np.testing.assert_array_equal(
        bank_outputs(spec_at(RATE_HZ), values), bank_outputs(spec_at(RATE_HZ), -values)
    )


@SIGN.mark
def test_a_sign_that_flips_in_mid_stream_is_one_jump_and_leaves_the_filter_the_exact_one() -> (
    None
):
    values = forces(300, 6)
    values[150:] *= -1.0
    got, expected = (
        bank_outputs(spec_at(RATE_HZ), values),
        np.abs(by_scipy(spec_at(RATE_HZ), values)),
    )
    assert off(got, expected) < 1e-12


def upside_down(flip_beyond: float, seed: int) -> npt.NDArray[np.bool_]:
    """[6] which magnets of an unloaded, tared hand are turned round."""
    tared = np.random.default_rng(seed).normal(0.0, NOISE_RMS["N"], (5, 18))
    sign, _ = Preparation(
        5, "mean", flip_negative_normal=True, flip_beyond=flip_beyond
    ).learn(tared)
    return np.asarray(sign[2::3] < 0.0)


@SIGN.mark
def test_noise_turns_no_magnet_round_and_a_resting_field_below_zero_does() -> None:
    assert not any(upside_down(NORMAL_FLOOR["N"], seed).any() for seed in range(200))
    resting = np.tile([0.0, 0.0, -20.0], (5, 6)) + noise(5)
    sign, _ = Preparation(
        5, "mean", flip_negative_normal=True, flip_beyond=NORMAL_FLOOR["N"]
    ).learn(resting)
    np.testing.assert_array_equal(sign, np.tile([1.0, 1.0, -1.0], 6))


@SIGN.unguarded
def test_by_its_sign_alone_every_second_magnet_of_a_tared_hand_is_turned_round(
    record_property: Record,
) -> None:
    share = float(np.mean([upside_down(0.0, seed) for seed in range(200)]))
    record_property("share_turned_round_by_noise", share)
    assert 0.4 < share < 0.6
