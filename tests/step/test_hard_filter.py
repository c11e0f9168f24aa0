"""Hard cases of filter and features: long runs, large offsets, silence, bad samples, odd rates and
degenerate hands.

Tests marked unguarded take the guard away, in plain scipy or numpy, and watch what happens.
"""

from __future__ import annotations

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
    SIGN,
    SUBNORMAL,
)
from scipy.signal import sosfilt
from test_bank import bank_model, bank_outputs, spec_at

from holdfast.core.contract import NORMAL_FLOOR, FloatArray, Prediction, Sample, Unit
from holdfast.data.critical_points import offline_critical_points
from holdfast.data.recording import Recording
from holdfast.edge_runtime.graph import StepGraph, open_session, run_recording
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.edge_runtime.preparation import Preparation
from holdfast.step.detectors import sections
from holdfast.step.features import feature_graph
from holdfast.step.spec import BANDS_HZ, NOISE_RMS, RANGE_LIMIT, StepSpec

if TYPE_CHECKING:
    from conftest import Built

DEFAULT_MODEL = Path(__file__).resolve().parents[2] / "models" / "holdfast-150hz.onnx"
RATE_HZ = 150.0
CHUNK, TENTH = 20_000, 100_000
LongArray = npt.NDArray[np.longdouble]


def off(got: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """Largest error over the largest output."""
    return float(np.abs(got - expected).max() / np.abs(expected).max())


# The pole, and length


def chunks(steps: int, offset: float = 1e4) -> Iterator[FloatArray]:
    """[CHUNK, 3] again and again: noise on an offset, with a knock now and then."""
    for number in range(steps // CHUNK):
        rng = np.random.default_rng([5, number])
        noise = rng.normal(0.0, 4.0, (CHUNK, 3))
        yield offset + noise + 100.0 * (rng.random((CHUNK, 1)) < 1e-3)


@pytest.mark.parametrize("steps", [40_000, pytest.param(10**8, marks=pytest.mark.soak)])
@LONG.mark
def test_the_bank_is_no_further_from_the_exact_filter_at_the_end_than_at_the_beginning(
    steps: int,
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
    assert max(errors) < 1e-14
    assert (
        max(states) < 1e5
    )  # ten times the offset, which is part of the state as the last reading


# Offset


@cache
def step_of(
    unit: Unit, *groups: str, n_sensors: int = 2, rate_hz: float = RATE_HZ
) -> Any:
    return open_session(
        feature_graph(StepSpec(n_sensors, rate_hz, unit, groups)).SerializeToString()
    )


# Silence and subnormal numbers


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
        step_of("N", "now", "activity"),
        values,
        valid,
        ["features", "detectors"],
    )
    assert not out["features"].any()
    assert not out["detectors"].any()


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


# Rates and widths


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


@pytest.mark.parametrize("constant", [0.0, 5.0, -5.0, 1e5])
@DEGENERATE.mark
def test_a_trial_in_which_nothing_varies_has_no_critical_point_and_no_warning(
    constant: float,
) -> None:
    assert offline_critical_points(recording(np.full((900, 18), constant))) == []


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
