"""Force decides "nothing": contact with hysteresis, over a zero that follows an empty hand."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from small_model import session_of

from holdfast.core.contract import CLASSES, BoolArray, FloatArray
from holdfast.edge_runtime.graph import StepGraph, run_recording
from holdfast.export.verify import touching_input
from holdfast.step.guard import reference_contact
from holdfast.step.heads import ByForce
from holdfast.step.spec import ContactRule, StepSpec

RATE_HZ = 100.0
SPEC = StepSpec(6, RATE_HZ, "N", ("now", "scaled_sums"))


def rule_of(spec: StepSpec = SPEC) -> ContactRule:
    assert spec.contact is not None
    return spec.contact


def empty_of(values: FloatArray) -> BoolArray:
    """[T] whether the graph says that the hand is empty."""
    valid = np.ones((len(values), SPEC.n_sensors), np.bool_)
    out = run_recording(session_of(SPEC), values, valid, ["empty"])
    flags: BoolArray = out["empty"][:, 0]
    return flags


def stepped(
    values: FloatArray, valid: BoolArray, spec: StepSpec
) -> tuple[BoolArray, FloatArray]:
    """empty [T] and the zero after each sample [T, C], read from the state."""
    graph = StepGraph(session_of(spec), 1, ["empty"])
    # behind the history and its places (guard.py)
    row = spec.history_samples + 1
    empty, zero = [], []
    for now, flags in zip(values, valid, strict=True):
        graph.sample[0] = now
        graph.valid[0] = flags
        empty.append(bool(graph.step()["empty"][0, 0]))
        zero.append(graph.state[0, row].copy())
    return np.array(empty), np.array(zero)


def quiet(seconds: float, noise_n: float, drift_n_s: float = 0.0) -> FloatArray:
    """[T, C] of an open hand; every axis drifts, up or down."""
    rng = np.random.default_rng(7)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    drift = drift_n_s * t_s[:, None] * rng.choice([-1.0, 1.0], SPEC.n_channels)
    return drift + rng.normal(scale=noise_n, size=drift.shape)


@pytest.mark.parametrize("noise_n", [0.0, 0.003, 0.01, 0.04])
@pytest.mark.parametrize("drift_n_s", [0.0, 0.02])
def test_an_open_hand_with_any_noise_and_drift_is_empty(
    noise_n: float, drift_n_s: float
) -> None:
    empty = empty_of(quiet(20.0, noise_n, drift_n_s))
    assert empty[SPEC.settle_samples :].mean() >= 0.99
    assert not empty[: SPEC.settle_samples - 1].any()


def test_a_hold_is_seen_and_let_go_within_a_fifth_of_a_second() -> None:
    values = quiet(4.0, 0.02)
    values[100:250, 2::3] += 0.5
    empty = empty_of(values)
    assert empty[60:100].all()
    assert not empty[105:250].any()
    assert empty[270:].all()


@pytest.mark.parametrize("least", [6, 4])
def test_the_graph_follows_the_rule_in_plain_python(least: int) -> None:
    spec = msgspec.structs.replace(SPEC, min_valid_sensors=least)
    values, valid = touching_input(spec, rule_of(spec), seed=3)
    expected, zeros = reference_contact(values, valid, spec, rule_of(spec))
    empty, zero = stepped(values, valid, spec)
    assert expected.any()
    assert not expected.all()
    np.testing.assert_array_equal(empty, expected)
    np.testing.assert_allclose(zero, zeros, rtol=0, atol=1e-12)


def test_the_zero_stands_still_in_a_hold_and_while_the_state_is_unknown() -> None:
    values = quiet(6.0, 0.0, 0.02)
    valid = np.ones((600, 6), np.bool_)
    values[100:300, 2::3] += 1.0
    valid[400:420, 1] = False
    _, zero = stepped(values, valid, SPEC)
    moved = np.abs(np.diff(zero, axis=0)).max(axis=1)
    assert (moved[105:299] == 0.0).all()
    # lost for too long, the sensor settles again for as long as the history
    assert (moved[400 : 400 + 20 + SPEC.settle_samples - 2] == 0.0).all()
    assert (moved[60:95] > 0.0).all()


def test_a_hand_that_is_loaded_from_the_start_keeps_its_zero() -> None:
    values = quiet(3.0, 0.003)
    values[:, 2::3] += 0.2
    empty, zero = stepped(values, np.ones((300, 6), np.bool_), SPEC)
    assert not empty.any()
    assert not zero.any()


@pytest.mark.parametrize(("step_n", "ends"), [(0.15, True), (0.3, False)])
def test_a_small_offset_step_is_taken_in_a_large_one_stays_a_touch(
    step_n: float, ends: bool
) -> None:
    values = quiet(10.0, 0.003)
    values[300:, 2] += step_n
    empty = empty_of(values)
    assert empty[60:300].all()
    assert empty[900:].all() == ends
    if not ends:
        # it ends with the offset
        values[700:, 2] -= step_n
        assert empty_of(values)[760:].all()


def test_votes_of_an_empty_hand_are_for_nothing_and_in_contact_for_anything_else() -> (
    None
):
    votes = np.array([[50, 30, 10, 5, 1, 1, 1, 2]])
    rule = ByForce("situation", CLASSES, 100)
    assert rule.in_contact(votes).tolist() == [[0, 0, 60, 35, 1, 1, 1, 2]]
    assert rule.without_contact().tolist() == [50, 50, 0, 0, 0, 0, 0, 0]
    question = ByForce("p_risky_250ms", ("no", "yes"), 7)
    assert question.in_contact(np.array([[3, 4]])).tolist() == [[3, 4]]
    assert question.without_contact().tolist() == [7, 0]


def test_a_unit_without_a_noise_limit_leaves_nothing_to_the_learner() -> None:
    for unit in ("uT", "count"):
        assert (
            msgspec.structs.replace(SPEC, unit=unit, force_decides=None).contact is None
        )
    assert StepSpec.from_json(SPEC.to_json()) == SPEC
