"""Pooled features: a plain numpy reference, any hand card, any order, any turn, dead sensors."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from pooled_reference import PooledReference

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.hand_card import read_hand_card
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.step.features import feature_graph
from holdfast.step.guard import reference_flags
from holdfast.step.pooled import FAMILIES
from holdfast.step.spec import StepSpec

RATE_HZ = 100.0
HANDS = (
    "six-fingertips",
    "two-pad-gripper",
    "three-fingertips",
    "twelve-sensors",
    "pinch-pad",
    "eflesh-gripper",
)


def spec_of(hand: str, needed: int = 0) -> StepSpec:
    """needed: sensors; 0 for all."""
    card = read_hand_card(hand)
    n = card.n_sensors
    groups = tuple(FAMILIES)
    return StepSpec(
        n, RATE_HZ, "N", groups, needed or n, hand=card, force_decides=False
    )


def grip(n_sensors: int, length: int = 160, seed: int = 0) -> FloatArray:
    """Forces [T, C] of fingers that hold, some of them lightly, and let go at the end."""
    rng = np.random.default_rng(seed)
    values = np.cumsum(rng.normal(0.0, 0.05, (length, n_sensors, 3)), axis=0)
    values += rng.normal(0.0, 0.5, (n_sensors, 3))
    values[..., 2] += rng.choice([0.1, 1.0, 3.0], n_sensors)
    values[-30:, :, 2] -= 2.0
    return values.reshape(length, -1)


def features(
    spec: StepSpec, values: FloatArray, valid: BoolArray | None = None
) -> FloatArray:
    if valid is None:
        valid = np.ones((len(values), spec.n_sensors), dtype=np.bool_)
    session = open_session(feature_graph(spec).SerializeToString())
    return run_recording(session, values, valid, ["features"])["features"]


def reference(
    spec: StepSpec, values: FloatArray, usable: BoolArray | None = None
) -> FloatArray:
    assert spec.hand is not None
    thumb = [side == "thumb" for side in spec.hand.sensor_sides]
    plain = PooledReference(values, spec.rate_hz, spec.unit, thumb, usable)
    return np.hstack([plain.family(name) for name in FAMILIES])


@pytest.mark.parametrize("rate_hz", [RATE_HZ, 150.0])
@pytest.mark.parametrize("hand", HANDS)
def test_the_graph_is_the_reference_on_every_hand(hand: str, rate_hz: float) -> None:
    spec = msgspec.structs.replace(spec_of(hand), rate_hz=rate_hz)
    values = grip(spec.n_sensors)
    expected = reference(spec, values)
    np.testing.assert_allclose(features(spec, values), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("hand", ["six-fingertips", "twelve-sensors"])
def test_a_dead_sensor_weighs_nothing_until_its_history_is_whole_again(
    hand: str,
) -> None:
    spec = spec_of(hand, needed=2)
    values = grip(spec.n_sensors, length=220)
    valid = np.ones((len(values), spec.n_sensors), dtype=np.bool_)
    dead = [1, spec.n_sensors - 1]
    valid[90:110, dead] = False
    # what the driver hands over in place of a dead sensor is not looked at
    values[90:110, 3:6] = np.nan
    got = features(spec, values, valid)

    held = values.copy()
    held[90:110, 3:6] = values[89, 3:6]
    usable = valid.copy()
    usable[: spec.settle_samples - 1] = False
    usable[90 : 110 + spec.settle_samples - 1, dead] = False
    expected = reference(spec, held, usable)
    settled = slice(spec.settle_samples, None)
    np.testing.assert_allclose(got[settled], expected[settled], rtol=1e-5, atol=1e-6)


def test_the_order_of_the_sensors_of_a_side_changes_nothing() -> None:
    spec = spec_of("six-fingertips")
    values = grip(6).reshape(-1, 6, 3)
    other = values[:, [1, 0, 5, 3, 2, 4]]
    np.testing.assert_allclose(
        features(spec, values.reshape(-1, 18)),
        features(spec, other.reshape(-1, 18)),
        rtol=1e-4,
        atol=1e-5,
    )


def test_no_sensor_knows_how_it_is_turned_or_mirrored() -> None:
    spec = spec_of("six-fingertips")
    values = grip(6).reshape(-1, 6, 3)
    turned = values.copy()
    angles = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 6)
    x, y = values[..., 0], values[..., 1]
    turned[..., 0] = np.cos(angles) * x - np.sin(angles) * y
    turned[..., 1] = np.sin(angles) * x + np.cos(angles) * y
    expected = features(spec, values.reshape(-1, 18))
    for other in (turned, values * [-1.0, 1.0, 1.0]):
        got = features(spec, other.reshape(-1, 18))
        np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)


def test_six_sensors_without_a_card_are_the_thesis_hand() -> None:
    with_card = spec_of("six-fingertips")
    without = StepSpec(6, RATE_HZ, "N", with_card.groups, 6, force_decides=False)
    values = grip(6)
    np.testing.assert_array_equal(
        features(without, values), features(with_card, values)
    )


def flags_of(spec: StepSpec, valid: BoolArray) -> dict[str, BoolArray]:
    values = grip(spec.n_sensors, length=len(valid))
    session = open_session(feature_graph(spec).SerializeToString())
    names = ["unknown", "settled", "usable_sensors"]
    got = run_recording(session, values, valid, names)
    for name, expected in reference_flags(values, valid, spec).items():
        np.testing.assert_array_equal(got[name], expected)
    return got


def test_a_hand_without_a_usable_sensor_on_one_side_is_unknown() -> None:
    card = read_hand_card("six-fingertips")
    spec = StepSpec(6, RATE_HZ, "N", tuple(FAMILIES), hand=card)
    assert spec.min_valid_sensors == 4
    valid = np.ones((200, 6), dtype=np.bool_)
    # both thumb sensors: four are left, all on the other side
    valid[80:90, :2] = False
    # one of each side: four are left
    valid[160:, [0, 5]] = False
    got = flags_of(spec, valid)
    assert got["unknown"][80:90].all()
    assert not got["unknown"][160:].any()
    assert (got["usable_sensors"][160:] == 4).all()


def test_fewer_than_two_thirds_of_the_sensors_are_unknown() -> None:
    spec = StepSpec(6, RATE_HZ, "N", ("pooled_shear",))
    valid = np.ones((120, 6), dtype=np.bool_)
    valid[80:, [1, 4, 5]] = False
    assert flags_of(spec, valid)["unknown"][80:].all()
