"""Single sensors that freeze, where no counter of a chip says whether a reading is new."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hazard_marks import FROZEN_SENSOR
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import BoolArray, FloatArray, Prediction, Sample
from holdfast.edge_runtime.health import FROZEN_S, LEAST_SPAN, NOISY_S, FrozenWatch
from holdfast.edge_runtime.monitor import GripMonitor, Model

ALL = np.ones(6, dtype=np.bool_)
RATE_HZ = 150.0
PERIOD_NS = 1e9 / RATE_HZ
MOST, ENOUGH = round(FROZEN_S * RATE_HZ), round(NOISY_S * RATE_HZ)
HELD_N = np.tile([0.1, 0.1, 2.0], 6)


def noise(count: int, seed: int = 1) -> FloatArray:
    """[count, 18] of a hand that is held still, N."""
    return HELD_N + 0.02 * np.random.default_rng(seed).normal(size=(count, 18))


def with_frozen(values: FloatArray, sensors: list[int], since: int) -> FloatArray:
    """The same, where some sensors repeat one reading."""
    frozen = values.copy().reshape(len(values), 6, 3)
    frozen[since:, sensors] = frozen[since, sensors]
    return frozen.reshape(len(values), 18)


def watched(
    values: FloatArray, rate_hz: float = RATE_HZ, usable: BoolArray | None = None
) -> BoolArray:
    """[T, S] which sensors a fresh watch calls frozen."""
    n_sensors = values.shape[1] // 3
    watch = FrozenWatch(n_sensors, rate_hz)
    flags = np.ones((len(values), n_sensors), bool) if usable is None else usable
    rows = zip(values, flags, strict=True)
    return np.array([watch.frozen(row, here).copy() for row, here in rows])


def answers(
    model: Model, values: FloatArray, *, has_counters: bool = False
) -> list[Prediction]:
    """The answers of a fresh monitor."""
    monitor = GripMonitor(model, None, has_counters=has_counters)
    samples = (
        Sample(round(k * PERIOD_NS), row, ALL, k) for k, row in enumerate(values)
    )
    return [monitor.feed(sample) for sample in samples]


@FROZEN_SENSOR.mark
def test_five_frozen_sensors_and_a_live_one_are_unknown_within_a_quarter_second(
    model: Model,
) -> None:
    """1300 of 1300 such samples were called grasp before."""
    answered = answers(model, with_frozen(noise(1500), [0, 1, 2, 3, 4], 200))
    assert "unknown" not in {answer.state for answer in answered[150:200]}
    assert {answer.state for answer in answered[200 + MOST + 5 :]} == {"unknown"}


@FROZEN_SENSOR.mark
def test_where_the_model_has_enough_others_a_frozen_sensor_is_degraded(
    model: Model,
) -> None:
    assert model.card.min_valid_sensors == 4
    answered = answers(model, with_frozen(noise(400), [5], 200))
    assert not any(answer.degraded for answer in answered[: 200 + MOST])
    assert all(answer.degraded for answer in answered[200 + MOST + 1 :])
    assert "unknown" not in {answer.state for answer in answered[150:]}


def test_a_hand_whose_chips_count_their_readings_is_not_judged_by_them(
    model: Model,
) -> None:
    values = with_frozen(noise(500), [0, 1, 2, 3, 4], 200)
    answered = answers(model, values, has_counters=True)[150:]
    assert not any(answer.degraded or answer.why for answer in answered)


@pytest.mark.parametrize("rate_hz", [20.0, 57.0, 150.0, 400.0])
def test_the_times_hold_at_every_rate(rate_hz: float) -> None:
    since = round(3 * rate_hz)
    found = watched(with_frozen(noise(2 * since), [2], since), rate_hz)[:, 2]
    first = int(np.flatnonzero(found)[0])
    assert first == since + max(LEAST_SPAN, round(FROZEN_S * rate_hz))


# -- what repeats at rest is never judged


@settings(max_examples=25)
@given(
    st.floats(0.0, 0.5),
    st.integers(0, 2**32 - 1),
    st.lists(st.floats(-0.5, 0.5), min_size=18, max_size=18),
)
def test_noise_below_half_a_step_of_the_converter_is_never_judged(
    spread: float, seed: int, between: list[float]
) -> None:
    """At any reading between two steps, and through two touches."""
    rng = np.random.default_rng(seed)
    force = np.zeros((900, 18))
    # a finger is touched: it moves by many steps, with the tremor of a hand
    touch = 20.0 + 5.0 * np.sin(2 * np.pi * 8.0 * np.arange(250) / RATE_HZ)
    force[200:450, :6] = force[600:850, 3:9] = touch[:, None]
    values = np.rint(force + between + spread * rng.normal(size=force.shape))
    # one sensor always lives
    values[:, 17] += 50.0 * rng.normal(size=900)
    assert not watched(values)[:, :5].any()


# -- the law, by another way


def by_the_book(values: FloatArray, usable: BoolArray) -> BoolArray:
    """[T, S]: each sensor on its own, from lists of its own samples."""
    n_rows, n_sensors = usable.shape
    readings = values.reshape(n_rows, n_sensors, 3)
    last = np.zeros((n_sensors, 3))
    moved = np.zeros((n_rows, n_sensors), dtype=np.bool_)
    change = np.zeros((n_rows, n_sensors, 3))
    for row in range(n_rows):
        here = usable[row]
        change[row, here] = readings[row, here] - last[here]
        moved[row] = (change[row] != 0.0).any(axis=1)
        last[here] = readings[row, here]
    found = np.zeros((n_rows, n_sensors), dtype=np.bool_)
    others: BoolArray = np.logical_or.reduce(moved, axis=1)
    for sensor in range(n_sensors):
        mine = np.flatnonzero(usable[:, sensor])
        found[:, sensor] = _one_sensor(
            mine, moved[:, sensor], change[:, sensor], others
        )
    return found


def _one_sensor(
    mine: np.ndarray, moved: BoolArray, change: FloatArray, others: BoolArray
) -> BoolArray:
    found = np.zeros(len(moved), dtype=np.bool_)
    repeats: list[bool] = []
    score, noisy, rests, before = 0, False, False, np.zeros(3)
    state = False
    for row in range(len(moved)):
        if row not in mine:
            found[row] = state
            continue
        if moved[row]:
            if MOST // 3 <= sum(repeats) < MOST:
                score, noisy = 0, False
            repeats = []
        else:
            repeats.append(bool(others[row]))
        if not noisy and not rests:
            turned = bool((before * change[row] < 0.0).any())
            score = max(0, score + (1 if turned else -2))
            noisy, rests = score >= ENOUGH, len(repeats) >= MOST
        before = change[row]
        state = noisy and sum(repeats) >= MOST
        found[row] = state
    return found


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.02, 0.3]))
def test_what_is_called_frozen_is_what_the_rule_says(seed: int, lost: float) -> None:
    """Noise, freezes of any length of any sensors, and losses."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(500, 9))
    for _ in range(rng.integers(1, 8)):
        first, sensor = rng.integers(0, 480), 3 * rng.integers(0, 3)
        stop = first + rng.integers(1, 120)
        values[first:stop, sensor : sensor + 3] = values[first, sensor : sensor + 3]
    usable = rng.uniform(size=(500, 3)) >= lost
    values[~np.repeat(usable, 3, axis=1)] = np.nan
    watch = watched(values, usable=usable)
    np.testing.assert_array_equal(watch, by_the_book(values, usable))


# -- on real and simulated hands, nothing that lives is called frozen


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("eflesh_slip", (0.0, 19.5, 39.0)),
        ("human_slip_uskin", (0.0, 0.0039, 0.039)),
    ],
)
def test_no_sensor_of_a_real_set_is_called_frozen_also_at_twelve_bits(
    real_set: Callable[[str], Path], name: str, steps: tuple[float, ...]
) -> None:
    """A part of each set; steps in its unit: as it is, at 12 bits of the chip, and coarser."""
    from holdfast.data.datasets import load

    recordings = load(real_set(name), windows="none").recordings
    for step in steps:
        for one in recordings[:: max(1, len(recordings) // 4)]:
            rows = np.rint(one.samples / step) * step if step else one.samples
            assert not watched(rows, one.rate_hz).any(), (one.trial_id, step)
