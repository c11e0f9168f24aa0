"""The step graph as a stream: however samples are handed in the answers are the same bits, and the
past ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime as ort
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pooled_reference import PooledReference
from small_model import session_of

from holdfast.core.contract import NORMAL_FLOOR, BoolArray, FloatArray, Unit
from holdfast.core.errors import UsageError
from holdfast.edge_runtime.graph import (
    BATCH,
    Outputs,
    open_session,
    run_recording,
    run_recordings,
)
from holdfast.edge_runtime.monitor import Model
from holdfast.step.features import (
    GROUPS,
    SPANS_S,
    feature_count,
    feature_graph,
    features_alone,
)
from holdfast.step.history import LAGS_S
from holdfast.step.pooled import FAMILIES
from holdfast.step.spec import StepSpec
from holdfast.training.plan import CLOCK_FREE_GROUPS

if TYPE_CHECKING:
    from conftest import Built

RATES_HZ = (50.0, 58.9, 150.0)
HISTORY_S = 0.5
Stream = tuple[FloatArray, BoolArray]


@cache
def sealed(path: Path) -> ort.InferenceSession:
    return Model(path).session


def whole_step(n_sensors: int) -> ort.InferenceSession:
    return session_of(StepSpec(n_sensors, 100.0, "N", tuple(GROUPS)))


def stream_of(length: int, n_sensors: int, seed: int = 0) -> Stream:
    """Forces that wander and shake, with lost sensors and readings that are no numbers."""
    rng = np.random.default_rng(seed)
    values = np.cumsum(
        rng.normal(0.0, 0.2, (length, 3 * n_sensors)), axis=0
    ) + rng.normal(size=3 * n_sensors)
    values[rng.random(values.shape) < 0.01] = np.nan
    return values, rng.random((length, n_sensors)) > 0.03


def numbers(length: int, n_sensors: int, seed: int = 0) -> FloatArray:
    """A stream without a fault."""
    rng = np.random.default_rng(seed)
    return rng.normal(2.0, 1.0, (length, 3 * n_sensors)) + rng.normal(
        size=3 * n_sensors
    )


def outputs_of(session: ort.InferenceSession) -> list[str]:
    return [
        output.name for output in session.get_outputs() if output.name != "state_out"
    ]


def alone(session: ort.InferenceSession, stream: Stream) -> Outputs:
    return run_recording(session, *stream, outputs_of(session))


def state_shape(session: ort.InferenceSession) -> list[int]:
    """[rows, C]."""
    return next(list(i.shape[1:]) for i in session.get_inputs() if i.name == "state")


def inputs(
    values: FloatArray, valid: BoolArray, reset: list[bool], state: FloatArray
) -> dict[str, np.ndarray]:
    """values [B, C], valid [B, n], reset [B] and state [B, rows, C] as the graph takes them."""
    return {
        "sample": values[:, None],
        "valid": valid[:, None],
        "reset": np.array(reset)[:, None, None],
        "state": state,
    }


def in_chunks(model: bytes, stream: Stream, cuts: list[int]) -> Outputs:
    """Chunk by chunk, nothing but the state's bytes carried over: every chunk has a session of its
    own."""
    carried, parts = b"", []
    for first, last in pairwise([0, *sorted(cuts), len(stream[0])]):
        session = open_session(model)
        shape = (1, *state_shape(session))
        state = np.frombuffer(carried).reshape(shape) if carried else np.zeros(shape)
        for row in range(first, last):
            given = inputs(
                stream[0][row : row + 1], stream[1][row : row + 1], [row == 0], state
            )
            *out, state = session.run([*outputs_of(session), "state_out"], given)
            parts.append(out)
        carried = state.tobytes()
    columns = zip(*parts, strict=True)
    return {
        name: np.concatenate(column)
        for name, column in zip(outputs_of(session), columns, strict=True)
    }


def bits(outputs: Outputs) -> dict[str, bytes]:
    return {
        name: np.ascontiguousarray(rows).tobytes() for name, rows in outputs.items()
    }


@given(
    seed=st.integers(0, 2**16),
    length=st.integers(1, 90),
    cuts=st.lists(st.integers(0, 90), max_size=4),
    data=st.data(),
)
@settings(max_examples=7)
def test_a_stream_in_random_chunks_gives_the_same_bits_as_sample_by_sample(
    eight_classes: Built, seed: int, length: int, cuts: list[int], data: st.DataObject
) -> None:
    features = feature_graph(StepSpec(6, 100.0, "N", tuple(GROUPS))).SerializeToString()
    model = data.draw(st.sampled_from([features, eight_classes.model.read_bytes()]))
    stream = stream_of(length, 6, seed)
    inside = [min(cut, length) for cut in cuts]
    assert bits(in_chunks(model, stream, inside)) == bits(
        alone(open_session(model), stream)
    )


@pytest.mark.parametrize("n_sensors", [1, 2, 6, 16])
@given(
    seed=st.integers(0, 2**16),
    lengths=st.lists(st.integers(0, 90), min_size=1, max_size=9),
)
@settings(max_examples=6)
def test_recordings_of_unequal_length_in_one_batch_give_the_bits_each_gives_alone(
    n_sensors: int, seed: int, lengths: list[int]
) -> None:
    batch_equals_alone(whole_step(n_sensors), n_sensors, seed, lengths)


@given(
    seed=st.integers(0, 2**16),
    lengths=st.lists(st.integers(1, 60), min_size=2, max_size=9),
    eight=st.booleans(),
)
@settings(max_examples=10)
def test_so_do_whole_models_down_to_the_probabilities(
    eight_classes: Built,
    four_situations: Built,
    seed: int,
    lengths: list[int],
    eight: bool,
) -> None:
    batch_equals_alone(
        sealed((eight_classes if eight else four_situations).model), 6, seed, lengths
    )


def test_more_recordings_than_one_batch_holds_come_back_in_their_own_order() -> None:
    batch_equals_alone(
        whole_step(2), 2, 0, [1 + (7 * k) % 13 for k in range(BATCH + 5)]
    )


def batch_equals_alone(
    session: ort.InferenceSession, n_sensors: int, seed: int, lengths: list[int]
) -> None:
    streams = [
        stream_of(length, n_sensors, seed + k) for k, length in enumerate(lengths)
    ]
    values, valid = [stream[0] for stream in streams], [stream[1] for stream in streams]
    rows = [np.arange(length) for length in lengths]
    together = run_recordings(session, values, valid, outputs_of(session), rows)
    for stream, out in zip(streams, together, strict=True):
        assert bits(out) == bits(alone(session, stream))


@given(seed=st.integers(0, 2**16), wanted=st.sets(st.integers(0, 59), max_size=8))
@settings(max_examples=10)
def test_the_requested_rows_are_the_rows_that_come(seed: int, wanted: set[int]) -> None:
    session, stream = whole_step(2), stream_of(60, 2, seed)
    rows = np.array(sorted(wanted), dtype=np.int64)
    (some,) = run_recordings(
        session, [stream[0]], [stream[1]], ["features", "unknown"], [rows]
    )
    every = alone(session, stream)
    assert bits(some) == bits({name: every[name][rows] for name in some})


def test_an_all_zero_state_is_a_fresh_start_and_reset_forgets_any_other_even_nan() -> (
    None
):
    session, (values, valid) = whole_step(2), stream_of(1, 2)
    answers = []
    for reset, state in (
        (False, 0.0),
        (True, 0.0),
        (True, 3.5),
        (True, np.nan),
        (True, np.inf),
    ):
        given = inputs(
            values, valid, [reset], np.full((1, *state_shape(session)), state)
        )
        answers.append([out.tobytes() for out in session.run(None, given)])
    assert all(answer == answers[0] for answer in answers)


def last_features(spec: StepSpec, *streams: FloatArray) -> list[bytes]:
    """The features after the last of the samples of each stream."""
    valid = [np.ones((len(one), spec.n_sensors), dtype=np.bool_) for one in streams]
    rows = [np.array([len(one) - 1]) for one in streams]
    # together: that each has the bits it has alone is a test above
    outs = run_recordings(session_of(spec), streams, valid, ["features"], rows)
    return [out["features"].tobytes() for out in outs]


def inside(seconds: float, rate_hz: float) -> int:
    """How many samples back the oldest is that is not older than so many seconds."""
    return math.floor(seconds * rate_hz + 1e-9)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("name", GROUPS)
@given(seed=st.integers(0, 2**16), longer=st.integers(0, 40))
@settings(max_examples=3)
def test_a_group_sees_nothing_older_than_its_stated_memory(
    name: str, rate_hz: float, seed: int, longer: int
) -> None:
    spec = StepSpec(2, rate_hz, "N", (name,))
    values = numbers(120, 2, seed)
    oldest = len(values) - 1 - inside(GROUPS[name].memory_s, rate_hz)
    altered = values.copy()
    altered[:oldest] = 50.0 * numbers(oldest, 2, seed + 1)
    longer_life = np.concatenate([numbers(longer, 2, seed + 2), values])
    before, after, later = last_features(spec, values, altered, longer_life)
    assert after == before
    assert later == before  # no clock either


def test_the_clock_free_groups_exist_and_none_claims_a_longer_memory() -> None:
    assert max(GROUPS[name].memory_s for name in CLOCK_FREE_GROUPS) <= HISTORY_S


def test_a_rate_a_rounding_error_below_its_name_does_not_cost_the_window_a_sample() -> (
    None
):
    assert (
        StepSpec(
            6, 1.0 / np.median(np.diff(np.arange(50) * 0.02)), "N", ("window",)
        ).window_samples
        == 6
    )


def test_an_unknown_group_is_refused_by_name() -> None:
    for groups in (("now", "gut_feeling"), ()):
        with pytest.raises(UsageError, match="gut_feeling" if groups else "none given"):
            feature_graph(StepSpec(2, 100.0, "N", groups))


@pytest.mark.parametrize("groups", [("window", "now"), ("now", "activity")])
def test_features_alone_have_the_bits_of_the_whole_step(
    groups: tuple[str, ...],
) -> None:
    spec, stream = StepSpec(2, 100.0, "N", groups), stream_of(120, 2)
    whole, alone = (
        run_recording(
            open_session(made(spec).SerializeToString()), *stream, ["features"]
        )
        for made in (feature_graph, features_alone)
    )
    assert whole["features"].tobytes() == alone["features"].tobytes()
    assert whole["features"].any()


class Past:
    """Plain numpy over a whole stream; what the documentation of GROUPS calls x, Sum x, Zs and l.

    x: [T, n, 3]. Samples before the first are zero, as the state is.
    """

    def __init__(self, values: FloatArray, rate_hz: float, unit: Unit) -> None:
        self.x = values.reshape(len(values), -1, 3)
        self.rate_hz = rate_hz
        self.unit = unit
        self.total = self.x.sum(axis=1)
        self.floor = NORMAL_FLOOR[unit]
        self.scale = np.maximum(self.total[:, 2], self.floor)[:, None]

    def ago(self, signal: FloatArray, seconds: float) -> FloatArray:
        """signal[t - l], l in samples: the nearest to so many seconds that is one at least and 0.5
        s at most."""
        lag = min(
            max(1, round(seconds * self.rate_hz)), inside(HISTORY_S, self.rate_hz)
        )
        return before(signal, lag)

    def changes(self) -> FloatArray:
        """[T, lags, 3]: Sum x[t] - Sum x[t-l]."""
        return np.stack(
            [self.total - self.ago(self.total, lag_s) for lag_s in LAGS_S], axis=1
        )


def before(signal: FloatArray, lag: int) -> FloatArray:
    """signal[t - lag], zero before the first."""
    return np.concatenate([np.zeros((lag, *signal.shape[1:])), signal])[: len(signal)]


def window(past: Past) -> FloatArray:
    """Sensor by sensor, oldest sample first."""
    length = max(2, inside(0.10, past.rate_hz) + 1)
    return np.stack(
        [before(past.x, back) for back in range(length - 1, -1, -1)], axis=2
    )


def differences(past: Past) -> FloatArray:
    """Sensor by sensor, lag by lag."""
    return np.stack([past.x - past.ago(past.x, lag_s) for lag_s in LAGS_S], axis=2)


def scaled_differences(past: Past) -> FloatArray:
    chosen = np.stack(
        [past.x - past.ago(past.x, lag_s) for lag_s in (0.10, 0.25, 0.50)], axis=2
    )
    return chosen / past.scale[:, None, None]


def activity(past: Past) -> FloatArray:
    steps = np.abs(past.total - before(past.total, 1))

    def mean(span_s: float) -> FloatArray:
        lag = min(max(1, round(span_s * past.rate_hz)), inside(HISTORY_S, past.rate_hz))
        return (
            np.mean([before(steps, back) for back in range(lag)], axis=0) / past.scale
        )

    return np.stack([mean(span_s) for span_s in SPANS_S], axis=1)


ORACLES: dict[str, Callable[[Past], FloatArray]] = {
    "window": window,
    "now": lambda past: past.x,
    "differences": differences,
    "scaled_differences": scaled_differences,
    "scaled_sums": lambda past: past.changes() / past.scale[:, None],
    "activity": activity,
}


def pooled(name: str) -> Callable[[Past], FloatArray]:
    """The family again; four sensors without a card lie on one side."""

    def of(past: Past) -> FloatArray:
        values = past.x.reshape(len(past.x), -1)
        return PooledReference(values, past.rate_hz, past.unit, [True] * 4).family(name)

    return of


ORACLES.update({name: pooled(name) for name in FAMILIES})


def test_every_group_has_an_oracle_here() -> None:
    """A new group needs its formula a second time, in plain numpy."""
    assert set(GROUPS) == set(ORACLES)


@pytest.mark.parametrize(
    ("rate_hz", "unit", "size"),
    [(50.0, "N", 1.0), (58.9, "count", 700.0), (150.0, "uT", 200.0)],
)
@pytest.mark.parametrize("name", sorted(set(GROUPS) & set(ORACLES)))
def test_a_group_is_the_formula_it_is_documented_with(
    name: str, rate_hz: float, unit: Unit, size: float
) -> None:
    spec = StepSpec(4, rate_hz, unit, (name,), min_valid_sensors=4)
    values = size * numbers(round(1.2 * rate_hz), 4)
    # the hand opens: the floor under the ratios is used too
    values[len(values) // 2 :, 2::3] -= 2.5 * size
    got = alone(session_of(spec), (values, np.ones((len(values), 4), dtype=np.bool_)))[
        "features"
    ]
    expected = ORACLES[name](Past(values, rate_hz, unit)).reshape(len(values), -1)
    assert got.shape == (len(values), feature_count(spec))
    np.testing.assert_allclose(
        got, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )


def test_groups_stand_in_the_order_they_are_named_in() -> None:
    names = tuple(sorted(GROUPS, reverse=True))
    stream = stream_of(20, 2)
    parts = [
        alone(session_of(StepSpec(2, 100.0, "N", (name,))), stream)["features"]
        for name in names
    ]
    whole = alone(session_of(StepSpec(2, 100.0, "N", names)), stream)["features"]
    np.testing.assert_array_equal(whole, np.concatenate(parts, axis=1))
