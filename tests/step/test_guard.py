"""The input guard: bad readings are held, never seen, and the state says unknown for exactly as
long as it must."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import onnxruntime as ort
import pytest
from hard_marks import BAD_SAMPLE, GAPS, MISSING
from hypothesis import given, settings
from hypothesis import strategies as st
from small_model import session_of
from test_bank import bank_model

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import ChannelError
from holdfast.edge_runtime.graph import Outputs, StepGraph, open_session, run_recording
from holdfast.edge_runtime.monitor import Model
from holdfast.step.features import GROUPS
from holdfast.step.guard import reference_flags
from holdfast.step.spec import RANGE_LIMIT, StepSpec

if TYPE_CHECKING:
    from conftest import Built

SENSORS = 3
LIMIT = RANGE_LIMIT["N"]
NUMBERS = [math.nan, math.inf, -math.inf, 1e30, -1e30, LIMIT, -LIMIT, 1e308]
INVALID = "the driver says so"
BAD: list[float | str] = [*NUMBERS, INVALID]


def spec_of(
    *groups: str, rate_hz: float = 100.0, min_valid_sensors: int = 0
) -> StepSpec:
    return StepSpec(SENSORS, rate_hz, "N", groups or tuple(GROUPS), min_valid_sensors)


@cache
def bank_session(spec: StepSpec) -> ort.InferenceSession:
    """Guard and bank alone: bank outputs [bands, C] in float64; the bank is the last of the state's
    rows."""
    # without the contact rule, whose zero is set behind the bank
    return open_session(bank_model(msgspec.structs.replace(spec, force_decides=False)))


def stepped(
    session: ort.InferenceSession, values: FloatArray, valid: BoolArray
) -> Outputs:
    """Every output [T, ..] and the state [T, rows, C] after every sample."""
    graph = StepGraph(session)
    kept: dict[str, list[FloatArray]] = {name: [] for name in (*graph.out, "state")}
    for sample, ok in zip(values, valid, strict=True):
        graph.sample[0], graph.valid[0] = sample, ok
        for name, value in graph.step().items():
            kept[name].append(value[0].copy())
        kept["state"].append(graph.state[0].copy())
    return {name: np.array(rows) for name, rows in kept.items()}


def clean(
    length: int, seed: int = 0, sensors: int = SENSORS
) -> tuple[FloatArray, BoolArray]:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0.0, 0.2, (length, 3 * sensors)), axis=0), np.ones(
        (length, sensors), dtype=np.bool_
    )


def spoil(
    values: FloatArray,
    valid: BoolArray,
    row: int,
    sensor: int,
    how: float | str,
    axis: int = 0,
) -> None:
    if isinstance(how, str):
        valid[row, sensor] = False
    else:
        values[row, 3 * sensor + axis] = how


def of(sensor: int) -> slice:
    """A sensor's columns."""
    return slice(3 * sensor, 3 * sensor + 3)


def bits(array: FloatArray) -> bytes:
    return np.ascontiguousarray(array).tobytes()


@BAD_SAMPLE.mark
@pytest.mark.parametrize("how", BAD, ids=str)
@pytest.mark.parametrize("axis", range(3))
def test_a_bad_reading_is_replaced_by_that_sensors_last_good_one_and_no_other_is_touched(
    how: float | str, axis: int
) -> None:
    values, valid = clean(12)
    expected = values.copy()
    expected[[7, 8], 3:6] = values[6, 3:6]
    for row in (7, 8):
        spoil(values, valid, row, 1, how, axis)
    now = run_recording(session_of(spec_of("now")), values, valid, ["features"])[
        "features"
    ]
    np.testing.assert_array_equal(now, expected.astype(np.float32))


@pytest.mark.parametrize(
    "value", [0.0, -0.0, 5e-324, np.nextafter(LIMIT, 0.0), -np.nextafter(LIMIT, 0.0)]
)
def test_a_reading_in_range_is_taken_as_it_is(value: float) -> None:
    values, valid = clean(4)
    values[3, 4] = value
    out = run_recording(session_of(spec_of("now")), values, valid, ["features"])[
        "features"
    ]
    np.testing.assert_array_equal(out[3], values[3].astype(np.float32))


@BAD_SAMPLE.mark
@pytest.mark.parametrize("how", BAD, ids=str)
def test_one_sample_after_a_bad_one_the_filter_is_clean_as_if_its_clock_had_stood_still(
    how: float | str,
) -> None:
    spec = spec_of(rate_hz=150.0)
    values, valid = clean(60)
    without = [row for row in range(60) if row != 40]
    expected = stepped(bank_session(spec), values[without], valid[without])["rectified"]
    spoil(values, valid, 40, 1, how)
    got = stepped(bank_session(spec), values, valid)["rectified"][without]
    assert bits(got[..., of(1)]) == bits(expected[..., of(1)])


@st.composite
def corrupted(draw: st.DrawFn, sensors: int) -> tuple[FloatArray, BoolArray]:
    """A stream with any share of its readings spoilt in any of the ways, from any sample to any
    other."""
    values, valid = clean(70, seed=draw(st.integers(0, 2**16)), sensors=sensors)
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    first, last = sorted((draw(st.integers(0, 70)), draw(st.integers(0, 70))))
    share = draw(st.sampled_from([0.02, 0.3, 0.9, 1.0]))
    inside = np.zeros_like(values, dtype=np.bool_)
    inside[first:last] = rng.random((last - first, values.shape[1])) < share
    ways = draw(st.lists(st.sampled_from(NUMBERS), min_size=1, unique=True))
    values[inside] = rng.choice(ways, size=int(inside.sum()))
    valid[first:last] &= rng.random((last - first, sensors)) >= draw(
        st.sampled_from([0.0, 0.3, 1.0])
    )
    return values, valid


@BAD_SAMPLE.mark
@given(stream=corrupted(SENSORS))
@settings(max_examples=40)
def test_no_pattern_of_corruption_lets_a_number_that_is_not_finite_into_features_or_state(
    stream: tuple[FloatArray, BoolArray],
) -> None:
    out = stepped(session_of(spec_of()), *stream)
    assert np.isfinite(out["features"]).all()
    assert np.isfinite(out["state"]).all()


@MISSING.mark
@given(stream=corrupted(6))
@settings(max_examples=15)
def test_no_pattern_of_corruption_reaches_votes_or_probabilities(
    eight_classes: Built, stream: tuple[FloatArray, BoolArray]
) -> None:
    out = stepped(opened(eight_classes.model).session, *stream)
    full = out["votes"].sum(axis=1)
    assert np.isfinite(out["votes"]).all()
    assert (full == full[0]).all()
    assert np.isfinite(out["p_situation"]).all()
    np.testing.assert_allclose(out["p_situation"].sum(axis=1), 1.0, rtol=1e-5)


@cache
def opened(path: Path) -> Model:
    return Model(path)


@st.composite
def gaps(draw: st.DrawFn) -> BoolArray:
    """good [T, n]: runs of good and bad samples of any length, on every sensor for itself."""
    good = np.ones((260, SENSORS), dtype=np.bool_)
    for sensor in range(SENSORS):
        runs = draw(
            st.lists(
                st.tuples(st.integers(1, 120), st.sampled_from([1, 2, 3, 4, 40])),
                max_size=6,
            )
        )
        row = draw(st.sampled_from([0, 0, 1, 5]))
        good[:row, sensor] = False
        for well, ill in runs:
            good[row + well : row + well + ill, sensor] = False
            row += well + ill
    return good


@BAD_SAMPLE.mark
@pytest.mark.parametrize(
    ("rate_hz", "bridged"), [(50.0, 1), (58.9, 1), (100.0, 2), (150.0, 3)]
)
@pytest.mark.parametrize("needed", [0, 2])
@given(good=gaps())
@settings(max_examples=8)
def test_settled_and_unknown_follow_the_rule_in_plain_python_at_every_sample(
    rate_hz: float, bridged: int, needed: int, good: BoolArray
) -> None:
    """bridged: samples in the 20 ms whose loss costs no history."""
    spec = spec_of("now", rate_hz=rate_hz, min_valid_sensors=needed)
    assert spec.gap_samples == bridged
    values, _ = clean(len(good))
    expected = reference_flags(values, good, spec)
    out = run_recording(session_of(spec), values, good, list(expected))
    for name, flags in expected.items():
        np.testing.assert_array_equal(out[name], flags)


@GAPS.mark
def test_a_sensor_that_comes_back_after_a_long_gap_starts_its_filter_afresh() -> None:
    spec = spec_of(rate_hz=100.0)
    values, valid = clean(80)
    values[40:] += (
        50.0  # it comes back somewhere else: the jump over the gap is no vibration
    )
    valid[30:40, 1] = False
    out = stepped(bank_session(spec), values, valid)["rectified"]
    afresh = stepped(bank_session(spec), values[40:], valid[40:])["rectified"]
    assert bits(out[40:, :, of(1)]) == bits(afresh[..., of(1)])


@pytest.mark.parametrize("needed", [-1, SENSORS + 1])
def test_a_number_of_sensors_that_would_never_or_always_be_unknown_is_refused(
    needed: int,
) -> None:
    with pytest.raises(ChannelError, match="min_valid_sensors"):
        spec_of("now", min_valid_sensors=needed)
