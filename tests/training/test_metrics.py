"""Metrics: equal to scikit-learn's, unmoved by the order of rows, and honest about what is
absent."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, astuple
from typing import Any

import numpy as np
import pytest
from hard_marks import ABSENT
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import average_precision_score, f1_score, roc_auc_score

from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.figures import (
    PredictionFigures,
    SituationFigures,
    situation_lines,
)
from holdfast.training.metrics import (
    draw_groups,
    prediction_scores,
    rank,
    report,
    situation_scores,
)
from holdfast.training.recording import DataSet, LabelledRows, Recording

SEEDS = st.integers(0, 2**32 - 1)


def answers(seed: int, n_rows: int = 600, n_groups: int = 8) -> dict[str, Any]:
    """Answers that are often right, people of different size, and scores with many ties."""
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, 4, n_rows)
    predicted = np.where(rng.random(n_rows) < 0.7, truth, rng.integers(0, 4, n_rows))
    groups = np.sort(rng.integers(0, n_groups, n_rows)).astype(str)
    slips = (rng.random(n_rows) < 0.2).astype(int)
    score = np.round(slips * 0.3 + rng.random(n_rows), 1)
    return {
        "truth": truth,
        "predicted": predicted,
        "groups": groups,
        "slips": slips,
        "score": score,
    }


def flat(values: dict[str, Any]) -> dict[str, Any]:
    """Nested figures with dotted keys."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        inner = flat(value) if isinstance(value, dict) else {"": value}
        found |= {f"{key}.{rest}".rstrip("."): figure for rest, figure in inner.items()}
    return found


@given(seed=SEEDS)
@settings(max_examples=20)
def test_permuting_the_rows_changes_nothing(seed: int) -> None:
    one = answers(seed)
    mixed = np.random.default_rng(seed).permutation(len(one["truth"]))
    other = {name: values[mixed] for name, values in one.items()}
    assert situations_of(one) == situations_of(other)
    for figure, same in zip(
        astuple(predictions_of(one)), astuple(predictions_of(other)), strict=True
    ):
        assert figure == pytest.approx(same)


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
def test_weighted_figures_equal_scikit_learns_on_the_resampled_rows(seed: int) -> None:
    a = answers(seed)
    code = a["groups"].astype(int)
    draw = draw_groups(int(code.max()) + 1, 1, seed)[0]
    resampled = np.repeat(np.arange(len(code)), draw[code].astype(int))
    auc, precision = rank(a["slips"], a["score"]).auc_and_precision(draw[code])
    slips, score = a["slips"][resampled], a["score"][resampled]
    assert auc == pytest.approx(roc_auc_score(slips, score))
    assert precision == pytest.approx(average_precision_score(slips, score))


@pytest.mark.parametrize("seed", range(5))
def test_intervals_hold_the_figure(seed: int) -> None:
    a = answers(seed, n_rows=4000, n_groups=20)
    values = flat(asdict(situations_of(a, 500)) | asdict(predictions_of(a, 500)))
    intervals = [name for name in values if "_ci" in name]
    assert len(intervals) == 7
    for name in intervals:
        low, high = values[name]
        assert low < values[name.replace("_ci", "")] < high


def test_a_perfect_answer_scores_one() -> None:
    a = answers(0)
    values = situation_scores(a["truth"], a["truth"], a["groups"], n_draws=50)
    assert values.macro_f1 == 1.0
    assert values.macro_f1_ci == (1.0, 1.0)
    ranked = prediction_scores(
        a["slips"], a["slips"].astype(float), a["groups"], n_draws=50
    )
    assert (ranked.auc, ranked.average_precision) == (1.0, 1.0)


def test_the_seed_decides_the_intervals_and_nothing_else() -> None:
    a = answers(3)
    one, same, other = (
        situation_scores(a["truth"], a["predicted"], a["groups"], n_draws=50, seed=seed)
        for seed in (0, 0, 1)
    )
    assert one == same
    assert one.macro_f1_ci != other.macro_f1_ci
    assert one.f1 == other.f1


def test_one_group_has_no_intervals() -> None:
    a = answers(1, n_groups=1)
    values = flat(asdict(situations_of(a)) | asdict(predictions_of(a)))
    assert all((value is None) == ("_ci" in name) for name, value in values.items())


@ABSENT.mark
def test_an_absent_class_has_no_f1_and_does_not_count() -> None:
    truth, groups = np.array([1, 1, 3, 3]), list("abab")
    values = situation_scores(truth, np.array([1, 1, 3, 3]), groups, n_draws=10)
    assert values.f1 == {
        "nothing": None,
        "grasp": 1.0,
        "safe_slip": None,
        "risky_slip": 1.0,
    }
    assert values.f1_ci["nothing"] is None
    assert values.macro_f1 == 1.0
    values = situation_scores(truth, np.array([1, 2, 3, 3]), groups, n_draws=10)
    assert values.f1["safe_slip"] is None, "predicted, but not in the truth"
    assert values.macro_f1 == pytest.approx((2 / 3 + 1.0) / 2)


@ABSENT.mark
def test_one_class_only_has_no_auc() -> None:
    values = prediction_scores(
        np.zeros(4, int), np.arange(4.0), list("abab"), n_draws=10
    )
    assert values == PredictionFigures(None, None, None, None)


def test_a_report_has_the_promised_keys_and_is_json() -> None:
    a = answers(5)
    trial = a["groups"].astype(np.int64)
    empty = np.zeros((2, 3))
    recordings = [
        Recording(str(k), f"person {k}", empty, np.ones((2, 1), bool), 60.0, "N")
        for k in range(trial.max() + 1)
    ]
    tasks = {
        "situations": LabelledRows(
            trial, np.arange(len(trial)), a["truth"], ("n", "g", "s", "r")
        ),
        "predict_250ms": LabelledRows(
            trial, np.arange(len(trial)), a["slips"], ("no", "yes")
        ),
    }
    data = DataSet(
        "made", recordings, tasks, 60.0, "N", Preparation(), "made", True, ""
    )
    values = json.loads(
        json.dumps(
            report(data, a["predicted"], a["score"], n_draws=10).to_json(),
            allow_nan=False,
        )
    )
    assert (values["n_trials"], values["n_groups"]) == (8, 8)
    assert values["situations"].keys() == {"macro_f1", "macro_f1_ci", "f1", "f1_ci"}
    assert values["situations"]["f1"].keys() == {
        "nothing",
        "grasp",
        "safe_slip",
        "risky_slip",
    }
    assert values["predict_250ms"].keys() == {
        "auc",
        "auc_ci",
        "average_precision",
        "average_precision_ci",
    }
    assert "predict_250ms" not in report(data, a["predicted"], n_draws=10).to_json()


def test_a_thousand_draws_of_twenty_thousand_rows_take_seconds() -> None:
    a = answers(9, n_rows=23_000, n_groups=24)
    begin_s = time.process_time()
    prediction_scores(a["slips"], a["score"] + np.arange(23_000) * 1e-7, a["groups"])
    assert time.process_time() - begin_s < 30.0


SEEN = np.array([0, 1, 1, 3, 3, 1])
SEEN_BY = list("ababab")


def test_a_situation_absent_from_the_truth_is_a_dash_and_the_macro_f1_says_what_it_is_over() -> (
    None
):
    answered = np.array([0, 1, 2, 3, 3, 1])  # one window is called a safe slip
    figures = situation_scores(SEEN, answered, SEEN_BY, n_draws=10)
    macro, *each = situation_lines(figures, "trial")
    assert macro.startswith("macro F1 over nothing, grasp, risky slip alone  0.93")
    assert [line.split()[:3] for line in each] == [
        ["F1", "nothing", "1.000"],
        ["F1", "grasp", "0.800"],
        ["F1", "safe_slip", "-"],
        ["F1", "risky_slip", "1.000"],
    ]


def test_a_situation_that_is_never_recognised_has_an_f1_of_zero() -> None:
    truth = np.array([0, 1, 2, 3, 3, 1])
    macro, *each = situation_lines(
        situation_scores(truth, SEEN, SEEN_BY, n_draws=10), "trial"
    )
    assert macro.startswith("macro F1 over four situations  ")
    assert each[2].split()[:3] == ["F1", "safe_slip", "0.000"]


def test_without_a_window_nothing_is_averaged() -> None:
    nothing = np.zeros(0, dtype=np.int64)
    assert situation_lines(situation_scores(nothing, nothing, []), "trial") == [
        "macro F1 over no class alone  -",
        "  F1 nothing      -",
        "  F1 grasp        -",
        "  F1 safe_slip    -",
        "  F1 risky_slip   -",
    ]
