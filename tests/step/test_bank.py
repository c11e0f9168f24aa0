"""The band-pass bank in the step graph: scipy's answer, the bands' names, and how silence ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hard_marks import OFFSET, POLE, RATES, SILENCE
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto
from scipy.signal import sosfilt

from holdfast.core.contract import FloatArray
from holdfast.core.errors import RateError
from holdfast.edge_runtime.graph import StepGraph, open_session, run_recording
from holdfast.step.builder import GraphBuilder
from holdfast.step.detectors import add_bank, sections, step_matrix
from holdfast.step.features import feature_graph
from holdfast.step.guard import MOVED, add_guard
from holdfast.step.spec import BANDS_HZ, BandsLeftOut, StepSpec, bands_for

if TYPE_CHECKING:
    pass

RATES_HZ = (40.0, 58.9, 119.5, 150.0, 1000.0)
RELATIVE = 1e-12


def spec_at(rate_hz: float, n_sensors: int = 2) -> StepSpec:
    return StepSpec(n_sensors=n_sensors, rate_hz=rate_hz, unit="count", groups=("now",))


def bank_model(spec: StepSpec) -> bytes:
    """Guard and bank alone, with the bank's outputs [bands, C] in float64 instead of as float32
    features."""
    graph = GraphBuilder(spec.n_sensors)
    guarded = add_guard(graph, spec)
    n_states, n_bands = 1 + 4 * len(spec.usable_bands()), len(spec.usable_bands())
    product = add_bank(graph, spec, guarded).product
    outputs = graph.columns(product, n_states, n_states + n_bands)
    moved = graph.node("Gather", guarded.factors, [MOVED], axis=1)
    graph.node("Abs", graph.node("Mul", outputs, moved), out="rectified")
    graph.output(
        "rectified", TensorProto.DOUBLE, len(spec.usable_bands()), spec.n_channels
    )
    return graph.model().SerializeToString()


def bank_outputs(spec: StepSpec, values: FloatArray) -> FloatArray:
    """[T, n, 2, bands]: sensor, shear axis, band."""
    valid = np.ones((len(values), spec.n_sensors), dtype=np.bool_)
    out = run_recording(open_session(bank_model(spec)), values, valid, ["rectified"])[
        "rectified"
    ]
    return out.reshape(len(values), -1, spec.n_sensors, 3).transpose(0, 2, 3, 1)[
        :, :, :2
    ]


def forces(length: int, n_channels: int, seed: int = 0) -> FloatArray:
    """A wandering force with noise and one sudden step, far from zero from the first sample on."""
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.normal(0.0, 0.3, (length, n_channels)), axis=0) + rng.normal(
        size=(length, n_channels)
    )
    return 7.0 + wander + 20.0 * (np.arange(length) > length // 2)[:, None]


def by_scipy(spec: StepSpec, values: FloatArray) -> FloatArray:
    """[T, n, 2, bands]: every shear signal, from rest at its first value, through scipy's own
    filter."""
    shear = values.reshape(len(values), -1, 3)[:, :, :2]
    filtered = [
        sosfilt(sections(spec.rate_hz, band), shear - shear[0], axis=0)
        for band in spec.usable_bands()
    ]
    return np.stack(filtered, axis=-1)


def assert_equal_to(expected: FloatArray, got: FloatArray, within: float) -> None:
    """Within a share of each band's own largest output."""
    scale = np.abs(expected).max(axis=0)
    assert scale.min() > 0.0
    assert (np.abs(got - expected) / scale).max() <= within


@RATES.mark
@pytest.mark.parametrize("rate_hz", [*RATES_HZ, 10_000.0])
def test_the_graphs_bank_is_scipys_filter_from_rest_on_every_shear_signal(
    rate_hz: float,
) -> None:
    spec = spec_at(rate_hz)
    values = forces(min(round(3 * rate_hz), 1000), spec.n_channels)
    within = 1e-9 if rate_hz > 1000.0 else RELATIVE
    assert_equal_to(np.abs(by_scipy(spec, values)), bank_outputs(spec, values), within)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_a_tone_is_loudest_in_the_band_that_bears_its_name(rate_hz: float) -> None:
    spec = spec_at(rate_hz, n_sensors=1)
    t_s = np.arange(round(2.5 * rate_hz)) / rate_hz
    for place, band in enumerate(spec.usable_bands()):
        tone = np.repeat(np.sin(2 * np.pi * band * t_s + 0.3)[:, None], 3, axis=1)
        loudness = np.square(bank_outputs(spec, tone)[round(1.5 * rate_hz) :]).mean(
            axis=0
        )
        np.testing.assert_array_equal(loudness.argmax(axis=-1), place)


@RATES.mark
@pytest.mark.parametrize(
    ("rate_hz", "carried"),
    [
        (50.0, (10, 15, 20)),
        (50.1, (10, 15, 20)),
        (58.9, (10, 15, 20, 25)),
        (1000.0, BANDS_HZ),
    ],
)
def test_bands_at_or_above_half_the_rate_are_left_out(
    rate_hz: float, carried: tuple[float, ...]
) -> None:
    spec = spec_at(rate_hz)
    assert spec.usable_bands() == carried
    assert spec.lost_bands() == tuple(band for band in BANDS_HZ if band not in carried)
    assert bank_outputs(spec, forces(4, spec.n_channels)).shape[-1] == len(carried)


def test_bands_left_out_are_warned_of_by_name() -> None:
    with pytest.warns(BandsLeftOut, match=r"left out at 100 Hz: 50, 55 Hz"):
        spec_at(100.0).warn_of_lost_bands()


@RATES.mark
@pytest.mark.parametrize("rate_hz", [20.0, 12.5, 1.0])
def test_a_rate_that_carries_no_band_is_refused(rate_hz: float) -> None:
    for refused in (
        spec_at(rate_hz).usable_bands,
        spec_at(rate_hz).warn_of_lost_bands,
    ):
        with pytest.raises(RateError, match="none of the bands"):
            refused()
    with pytest.raises(RateError, match="none of the bands"):
        feature_graph(spec_at(rate_hz))


@POLE.mark
@given(rate_hz=st.floats(21.75, 20_000.0))
@settings(max_examples=60)
def test_every_eigenvalue_of_the_step_is_inside_the_unit_circle_at_any_rate(
    rate_hz: float,
) -> None:
    """The differentiator's pole at -1, on the circle, is gone."""
    bands = bands_for(rate_hz)
    size = 1 + 4 * len(bands)
    eigenvalues = np.linalg.eigvals(step_matrix(rate_hz, bands)[1:, :size])
    assert np.abs(eigenvalues).max() < 1.0


@RATES.mark
@given(rate_hz=st.floats(21.75, 1000.0))
@settings(max_examples=60)
def test_no_band_rings_for_more_than_a_second_after_it_was_named_at_any_rate(
    rate_hz: float,
) -> None:
    """Time constant of the slowest pole; two samples' worth of it are spared to rates under 30
    Hz."""
    bands = bands_for(rate_hz)
    size = 1 + 4 * len(bands)
    slowest = np.abs(np.linalg.eigvals(step_matrix(rate_hz, bands)[1:, :size])).max()
    assert -1.0 / (np.log(slowest) * rate_hz) < max(1.0, 40.0 / rate_hz)


@SILENCE.mark
@pytest.mark.parametrize("rate_hz", [50.0, 150.0])
def test_silence_ends_far_below_any_noise_and_passes_no_subnormal_number(
    rate_hz: float,
) -> None:
    spec = spec_at(rate_hz)
    graph = StepGraph(open_session(bank_model(spec)))
    loud = 1000.0 * np.random.default_rng(0).normal(size=(50, spec.n_channels))
    tiny = np.finfo(np.float64).tiny
    for values in (loud, np.repeat(loud[-1:], 4000, axis=0)):
        for sample in values:
            graph.sample[0] = sample
            out = graph.step()["rectified"]
            for numbers in (graph.state, out):
                assert not np.any((numbers != 0.0) & (np.abs(numbers) < tiny))
    bank = graph.state[0, -(1 + 4 * len(spec.usable_bands())) :]
    assert np.abs(bank).max() < 1e-50
    assert graph.out["rectified"].max() < 1e-50


@OFFSET.mark
@given(
    offset=st.integers(-(2**18), 2**18),
    numbers=st.lists(st.integers(-(2**10), 2**10), min_size=12, max_size=60),
)
@settings(max_examples=20)
def test_a_constant_offset_however_large_changes_nothing(
    offset: int, numbers: list[int]
) -> None:
    spec = spec_at(150.0, n_sensors=1)
    # exact with the offset on top
    values = np.array(numbers[: len(numbers) // 3 * 3]).reshape(-1, 3) / 64.0
    np.testing.assert_array_equal(
        bank_outputs(spec, values), bank_outputs(spec, values + offset)
    )
