"""Metrics: equal to scikit-learn's in any order of rows, and honest about what is absent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hard_marks import ABSENT
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import average_precision_score, f1_score, roc_auc_score

from holdfast.data.metrics import (
    PredictionFigures,
    SituationFigures,
    draw_groups,
    prediction_scores,
    situation_scores,
)

SEEDS = st.integers(0, 2**32 - 1)


def answers(seed: int, n_rows: int = 600, n_groups: int = 8) -> dict[str, Any]:
    """Answers that are often right, people of different size, and scores with many ties."""
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, 4, n_rows)
    predicted = np.where(rng.random(n_rows) < 0.7, truth, rng.integers(0, 4, n_rows))
    groups = rng.integers(0, n_groups, n_rows).astype(str)
    slips = (rng.random(n_rows) < 0.2).astype(int)
    score = np.round(slips * 0.3 + rng.random(n_rows), 1)
    return {
        "truth": truth,
        "predicted": predicted,
        "groups": groups,
        "slips": slips,
        "score": score,
    }


def with_intervals(a: dict[str, Any], n_draws: int = 50) -> list[tuple[Any, Any]]:
    """(figure, its interval) of all seven figures that have one."""
    s, p = situations_of(a, n_draws), predictions_of(a, n_draws)
    each = zip(s.f1.values(), s.f1_ci.values(), strict=True)
    ranking = [(p.auc, p.auc_ci), (p.average_precision, p.average_precision_ci)]
    return [(s.macro_f1, s.macro_f1_ci), *each, *ranking]


def situations_of(a: dict[str, Any], n_draws: int = 50) -> SituationFigures:
    return situation_scores(a["truth"], a["predicted"], a["groups"], n_draws=n_draws)


def predictions_of(a: dict[str, Any], n_draws: int = 50) -> PredictionFigures:
    return prediction_scores(a["slips"], a["score"], a["groups"], n_draws=n_draws)


@given(seed=SEEDS)
@settings(max_examples=20)
def test_figures_equal_scikit_learns(seed: int) -> None:
    a = answers(seed)
    values = situations_of(a)
    assert values.macro_f1 == pytest.approx(
        f1_score(a["truth"], a["predicted"], average="macro")
    )
    assert list(values.f1.values()) == pytest.approx(
        f1_score(a["truth"], a["predicted"], average=None)
    )
    assert predictions_of(a).auc == roc_auc_score(a["slips"], a["score"])
    assert predictions_of(a).average_precision == average_precision_score(
        a["slips"], a["score"]
    )


@given(seed=SEEDS)
@settings(max_examples=20)
def test_a_draw_equals_scikit_learns_figures_on_the_resampled_rows(seed: int) -> None:
    a = answers(seed)
    code = a["groups"].astype(int)
    draw = draw_groups(int(code.max()) + 1, 1, 0)[0]
    resampled = np.repeat(np.arange(len(code)), draw[code].astype(int))
    truth, predicted = a["truth"][resampled], a["predicted"][resampled]
    macro_f1 = f1_score(truth, predicted, average="macro")
    assert situations_of(a, 1).macro_f1_ci == pytest.approx([macro_f1] * 2)
    found = predictions_of(a, 1)
    slips, score = a["slips"][resampled], a["score"][resampled]
    assert found.auc_ci == pytest.approx([roc_auc_score(slips, score)] * 2)
    precision = average_precision_score(slips, score)
    assert found.average_precision_ci == pytest.approx([precision] * 2)


@pytest.mark.parametrize("seed", range(5))
def test_intervals_hold_the_figure(seed: int) -> None:
    a = answers(seed, n_rows=4000, n_groups=20)
    for figure, (low, high) in with_intervals(a, 500):
        assert low < figure < high


def test_one_group_has_no_intervals() -> None:
    for figure, interval in with_intervals(answers(1, n_groups=1)):
        assert figure is not None
        assert interval is None


@ABSENT.mark
def test_an_absent_class_has_no_f1_and_does_not_count() -> None:
    truth, groups = np.array([1, 1, 3, 3]), list("abab")
    values = situation_scores(truth, truth, groups, n_draws=10)
    assert list(values.f1.values()) == [None, 1.0, None, 1.0]
    assert values.f1_ci["nothing"] is None
    assert (values.macro_f1, values.macro_f1_ci) == (1.0, (1.0, 1.0))
    values = situation_scores(truth, np.array([1, 2, 3, 3]), groups, n_draws=10)
    assert values.f1["safe_slip"] is None, "predicted, but not in the truth"
    assert values.macro_f1 == pytest.approx((2 / 3 + 1.0) / 2)


@ABSENT.mark
def test_one_class_only_has_no_auc() -> None:
    values = prediction_scores(
        np.zeros(4, int), np.arange(4.0), list("abab"), n_draws=10
    )
    assert values == PredictionFigures(None, None, None, None)
