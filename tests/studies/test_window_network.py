"""The small convolutional network on people: its gradients, learning and whole numbers."""

from __future__ import annotations

import numpy as np
import pytest

from studies.real.window_network import (
    Inputs,
    fitted,
    rolled_back,
    shares,
    unrolled,
    whole_votes,
)


@pytest.mark.parametrize(("width", "step"), [(5, 2), (3, 1), (3, 2)])
def test_a_gradient_takes_the_way_back_that_its_value_came(
    width: int, step: int
) -> None:
    """The way back is the transpose: both products with any gradient are the same."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=(4, 13, 3)).astype(np.float32)
    seen = unrolled(values, width, step)
    gradient = rng.normal(size=seen.shape).astype(np.float32)
    back = rolled_back(gradient, values.shape, width, step)
    assert np.sum(seen * gradient) == pytest.approx(np.sum(values * back), rel=1e-3)


def test_it_learns_a_rise_and_keeps_its_answers_in_whole_numbers() -> None:
    rng = np.random.default_rng(1)
    label = rng.integers(0, 2, 1500)
    relative = 0.3 * rng.uniform(-1, 1, (1500, 30, 6)).astype(np.float32)
    # one channel rises or falls over the window
    relative[:, :, 2] += np.linspace(-0.3, 0, 30) * np.where(label, 1, -1)[:, None]
    whole = np.round(np.clip(relative, -1, 1) * 511) / 511
    inputs = Inputs(whole.astype(np.float32), np.zeros((1500, 8), np.float32))
    train, test = inputs.take(np.arange(1000)), inputs.take(np.arange(1000, 1500))

    weights, _ = fitted(train, label[:1000], 2, 0.0, 25, 0)
    real = shares(weights, test)
    votes = whole_votes(weights, train, test, 1 << 20)
    assert (np.argmax(real, axis=1) == label[1000:]).mean() > 0.95
    np.testing.assert_allclose(votes / (1 << 20), real, atol=0.05)
