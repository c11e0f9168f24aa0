"""Short text tables: windows of a set, F1 of each situation."""

from __future__ import annotations

import numpy as np

from holdfast.training.figures import situation_lines
from holdfast.training.metrics import situation_scores

TRUTH = np.array([0, 1, 1, 3, 3, 1])
GROUPS = list("ababab")


def test_a_situation_absent_from_the_truth_is_a_dash_and_the_macro_f1_says_what_it_is_over() -> (
    None
):
    answered = np.array([0, 1, 2, 3, 3, 1])  # one window is called a safe slip
    figures = situation_scores(TRUTH, answered, GROUPS, n_draws=10)
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
        situation_scores(truth, TRUTH, GROUPS, n_draws=10), "trial"
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
