"""Gains of one answer over another at the same windows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.training.metrics import (
    macro_f1_gain,
    prediction_gains,
    prediction_scores,
    situation_scores,
)

PEOPLE, EACH = 8, 40


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Truth, people, and two answers: of each person, the second is as good or as bad."""
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, 4, PEOPLE * EACH)
    people = np.repeat(np.arange(PEOPLE), EACH)

    def mostly(answer: np.ndarray, share: float | np.ndarray) -> np.ndarray:
        guess = rng.integers(0, 4, len(truth))
        return np.where(rng.random(len(truth)) < share, answer, guess)

    ours = mostly(truth, rng.uniform(0.1, 0.9, PEOPLE)[people])
    return truth, people, ours, mostly(ours, 0.9)


@given(st.integers(0, 2**32 - 1))
def test_a_gain_is_the_difference_of_the_figures_and_turns_round_with_the_answers(seed):
    truth, people, ours, theirs = drawn(seed)
    here = situation_scores(truth, ours, people, n_draws=20)
    there = situation_scores(truth, theirs, people, n_draws=20)
    gain = macro_f1_gain(truth, ours, theirs, people, n_draws=20)
    back = macro_f1_gain(truth, theirs, ours, people, n_draws=20)
    assert gain.value == pytest.approx(here.macro_f1 - there.macro_f1)
    assert back.value == pytest.approx(-gain.value)
    assert back.ci == pytest.approx((-gain.ci[1], -gain.ci[0]))


def test_an_answer_gains_nothing_over_itself_and_that_is_certain():
    truth, people, ours, _ = drawn(0)
    gain = macro_f1_gain(truth, ours, ours, people)
    assert (gain.value, gain.ci) == (0.0, (0.0, 0.0))


def test_the_interval_of_a_gain_is_narrower_than_those_of_the_figures_suggest():
    truth, people, ours, theirs = drawn(1)
    alone = situation_scores(truth, ours, people).macro_f1_ci
    gain = macro_f1_gain(truth, ours, theirs, people).ci
    assert gain[1] - gain[0] < 0.5 * (alone[1] - alone[0])


def test_gains_of_scores_are_those_of_auc_and_average_precision():
    rng = np.random.default_rng(2)
    truth, people = rng.integers(0, 2, 300), np.repeat(np.arange(6), 50)
    ours, theirs = truth + rng.normal(size=300), truth + 3.0 * rng.normal(size=300)
    here = prediction_scores(truth, ours, people, n_draws=0)
    there = prediction_scores(truth, theirs, people, n_draws=0)
    auc, precision = prediction_gains(truth, ours, theirs, people, n_draws=200)
    assert auc.value == pytest.approx(here.auc - there.auc)
    gain = here.average_precision - there.average_precision
    assert precision.value == pytest.approx(gain)
    assert auc.ci[0] < auc.value < auc.ci[1]


def test_without_both_classes_there_is_no_gain_in_ranking():
    people = np.repeat(np.arange(4), 5)
    truth, scores = np.zeros(20, np.int64), np.arange(20.0)
    auc, precision = prediction_gains(truth, scores, scores, people)
    assert auc.value is precision.value is None
