"""The friction margin: nothing before a slip, right after one, and never a guess."""

from __future__ import annotations

import numpy as np
import pytest
from grip_senses import RATE_HZ, sense

from holdfast.edge_runtime.batch import ONE_HAND
from holdfast.edge_runtime.grip_control import SPARE, FrictionMargin

GRIP_N = 4.0


def holding(
    margin: FrictionMargin, ratio: float, samples: int = 60, **changes: object
) -> None:
    """Hold without slip at a ratio of load to both sides' grip."""
    for _ in range(samples):
        margin.step(sense(grip_n=GRIP_N, load_n=2.0 * GRIP_N * ratio, **changes))


def sliding(
    margin: FrictionMargin,
    friction: float,
    samples: int = 20,
    noise: float = 0.0,
    seed: int = 0,
) -> None:
    """Slide: the load is what friction bears, read with noise."""
    rng = np.random.default_rng(seed)
    for factor in 1.0 + noise * rng.normal(size=samples):
        load_n = 2.0 * GRIP_N * friction * factor
        margin.step(sense(grip_n=GRIP_N, load_n=load_n, p_risky=1.0))


def margin_of(gain: float = 1.0) -> FrictionMargin:
    return FrictionMargin(ONE_HAND, RATE_HZ, gain)


def estimates(margin: FrictionMargin) -> tuple[float, float, float]:
    return margin.mu_hat, margin.margin, margin.needed_n


@pytest.mark.parametrize("friction", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("seed", range(5))
def test_the_estimate_is_right_within_15_percent_under_noise_of_5_percent(
    friction: float, seed: int
) -> None:
    margin = margin_of()
    sliding(margin, friction, samples=30, noise=0.05, seed=seed)
    assert margin.mu_hat == pytest.approx(friction, rel=0.15)
    assert margin.mu_hat <= 1.02 * friction


def test_more_grip_is_more_margin() -> None:
    margin = margin_of()
    sliding(margin, 0.6)
    margin.step(sense(grip_n=2.0 * GRIP_N, load_n=2.0 * GRIP_N * 0.6))
    assert margin.margin == pytest.approx(0.5)
    assert margin.needed_n == pytest.approx(SPARE * GRIP_N)


def test_the_largest_ratio_that_stood_still_is_the_friction() -> None:
    margin = margin_of()
    sliding(margin, 0.3)  # a hold that only looked like a slip
    sliding(margin, 0.6)
    sliding(margin, 0.2)
    assert margin.mu_hat == pytest.approx(0.6)


def test_the_estimate_is_never_below_a_ratio_that_the_hand_has_held_in_quiet() -> None:
    margin = margin_of()
    holding(margin, 0.8, samples=600)
    sliding(margin, 0.4)
    assert margin.held == pytest.approx(0.8, rel=1e-3)
    assert margin.mu_hat == margin.held


def test_before_a_slip_the_grip_that_holds_is_that_of_the_largest_ratio_held() -> None:
    margin = margin_of()
    holding(margin, 0.3, samples=600)
    assert margin.holds_n == pytest.approx(GRIP_N, rel=1e-3)
    margin.step(sense(grip_n=2.0 * GRIP_N, load_n=2.0 * GRIP_N * 0.3))
    assert (margin.mu_hat, margin.needed_n) == (0.0, 0.0)
    assert margin.holds_n == pytest.approx(GRIP_N, rel=1e-3)
    sliding(margin, 0.6)
    assert margin.holds_n == margin.needed_n


def test_an_empty_hand_forgets_the_object_and_an_unknown_one_does_not() -> None:
    margin = margin_of()
    holding(margin, 0.5, samples=600)
    sliding(margin, 0.6)
    margin.step(sense(grip_n=0.0, load_n=0.0, empty=True, known=False))
    assert margin.mu_hat == pytest.approx(0.6)
    assert margin.margin == 0.0
    margin.step(sense(grip_n=0.0, load_n=0.0, empty=True))
    assert (*estimates(margin), margin.held) == (0.0, 0.0, 0.0, 0.0)


def test_sensors_that_read_too_little_along_the_skin_are_corrected() -> None:
    margin = margin_of(0.5)
    sliding(margin, 0.3)
    assert margin.mu_hat == pytest.approx(0.6)
    # the grip that holds is the same, in newtons as the sensors read them
    exact = margin_of()
    sliding(exact, 0.3)
    assert margin.needed_n == pytest.approx(exact.needed_n)


@pytest.mark.parametrize(
    ("changes", "knows"),
    [
        ({}, True),
        ({"samples": 5}, False),
        ({"samples": 6}, True),
        ({"p_risky": 0.9}, False),
        ({"p_risky": 0.901}, True),
        ({"grip_n": 0.3}, False),
        ({"grip_n": 0.301}, True),
        ({"spread": 0.101}, False),
        ({"spread": 0.099}, True),
        ({"known": False}, False),
        ({"ratio": 0.04}, True),
    ],
)
def test_a_slide_is_sure_long_firm_and_steady(
    changes: dict[str, float], knows: bool
) -> None:
    slide = {"samples": 9, "spread": 0.0, "ratio": 0.6, "grip_n": 4.0, "p_risky": 1.0}
    slide |= changes
    samples, spread, ratio = (slide.pop(k) for k in ("samples", "spread", "ratio"))
    grip_n = slide["grip_n"]
    margin = margin_of()
    for k in range(int(samples)):
        now = ratio * (1.0 - spread * (k % 2))
        margin.step(sense(load_n=2.0 * now * grip_n, **slide))
    assert (margin.mu_hat > 0.0) == knows
    if knows:
        # the least of the row, and no less than the floor
        lower = max(0.05, ratio * (1.0 - spread))
        assert margin.mu_hat == pytest.approx(lower)
        assert margin.needed_n == pytest.approx(1.25 * now * grip_n / lower)
        assert margin.margin == pytest.approx(1.0 - now / lower)


@pytest.mark.parametrize(
    ("changes", "holds"),
    [
        ({}, True),
        ({"p_risky": 0.199}, True),
        ({"p_risky": 0.2}, False),
        ({"p_safe": 0.199}, True),
        ({"p_safe": 0.2}, False),
        ({"grip_n": 0.301, "load_n": 0.602}, True),
        ({"grip_n": 0.3, "load_n": 0.6}, False),
        ({"known": False}, False),
    ],
)
def test_a_ratio_is_held_in_a_firm_hold_in_which_nothing_may_slip(
    changes: dict[str, float], holds: bool
) -> None:
    margin = margin_of()
    margin.step(sense(**({"grip_n": 4.0, "load_n": 8.0} | changes)))
    # a first-order low-pass of 0.1 s, at 150 Hz
    assert margin.held == pytest.approx(1.0 / 16.0 if holds else 0.0)
