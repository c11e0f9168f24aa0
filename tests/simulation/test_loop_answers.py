"""The model file answers hands in a loop as it answers one hand live."""

from __future__ import annotations

import numpy as np
import pytest
from loop_bench import model

from holdfast.core.contract import Sample
from holdfast.edge_runtime.grip import GripSense
from holdfast.edge_runtime.grip_control import sense_of
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.preparation import Tare
from holdfast.simulation.loop.sensing import HandModels

SAMPLES = 150
HANDS = 2
SETTLED = 85
"""SETTLED: the loop is settled a sample after the live path, which uses the last row of a bias."""


def readings() -> np.ndarray:
    """[T, B, 18] of hands that close after 0.7 s, under noise, with a bias of their own."""
    rng = np.random.default_rng(2)
    touch = np.clip((np.arange(SAMPLES) - 105) / 20.0, 0.0, 1.0)[:, None, None]
    pressed = np.tile([0.2, -0.1, 1.0], 6) * np.array([[1.0], [2.0]])
    bias = rng.normal(size=(1, HANDS, 18))
    values: np.ndarray = (
        bias + touch * pressed + 0.02 * rng.normal(size=(SAMPLES, HANDS, 18))
    )
    return values


def live_senses(values: np.ndarray) -> list[GripSense]:
    """What the live path hands to the grip controller of one hand, values [T, 18]."""
    made = GripMonitor(model(), None)
    tare = Tare(model().card.preparation, 18)
    senses = []
    period_ns = 1e9 / model().card.rate_hz
    for k, row in enumerate(values):
        prepared, valid = tare.prepare(row, np.ones(6, dtype=np.bool_))
        sample = Sample(round(k * period_ns), prepared, valid, k)
        senses.append(sense_of(made.feed(sample), prepared, valid))
    return senses


def test_a_loop_of_hands_senses_what_the_live_path_senses() -> None:
    values = readings()
    loop = HandModels(model(), HANDS)
    every = np.ones((HANDS, 6), dtype=np.bool_)
    never = np.zeros(HANDS, dtype=np.bool_)
    looped = [loop.answer(now, every, never, never) for now in values]
    for hand in range(HANDS):
        live = live_senses(values[:, hand])
        assert sum(sense.known for sense in live) > 40
        assert {sense.empty for sense in live if sense.known} == {True, False}
        assert not any(many.empty[hand] for many in looped[:79])  # not known yet
        for one, many in zip(live[SETTLED:], looped[SETTLED:], strict=True):
            assert (one.known, one.empty) == (many.known[hand], many.empty[hand])
            assert one.p_risky == pytest.approx(many.p_risky[hand], abs=1e-6)
            assert one.p_safe == pytest.approx(many.p_safe[hand], abs=1e-6)
            assert one.grip_n == pytest.approx(many.grip_n[hand], rel=1e-5, abs=1e-5)
            assert one.load_n == pytest.approx(many.load_n[hand], rel=1e-5, abs=1e-5)
