"""Hard cases of calibration and metrics: certainty, absence, alarms that were on already, matrices
that are singular.

Tests marked unguarded compute the figure the usual way, and watch what happens.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hard_marks import ABSENT, CERTAIN, COLLAR, EMPTY, FOREIGN, SINGULAR
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.metrics import f1_score, log_loss, roc_auc_score

from holdfast.core.contract import SITUATIONS, FloatArray
from holdfast.core.errors import ClassMissing, DataError, LabelError, NotANumber
from holdfast.drivers.calibration import Calibration as FieldCalibration
from holdfast.drivers.calibration import (
    CalibrationOrigin,
    read_calibration,
    write_calibration,
)
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.preparation import Preparation
from holdfast.export.exporting import whole_graph
from holdfast.export.heads import Calibration, Head, reference_probability
from holdfast.export.learner import reference_votes
from holdfast.export.spec import StepSpec
from holdfast.export.verify import cut_learners
from holdfast.training.critical_points import band_pass_envelope, band_pass_rows
from holdfast.training.crossval import cross_validate, fit_calibration
from holdfast.training.figures import PredictionFigures, Share
from holdfast.training.metrics import prediction_scores, share_scores, situation_scores
from holdfast.training.plan import ForestPlan, TrainingPlan
from holdfast.training.recording import DataSet, LabelledRows, Recording

RATE_HZ = 100.0
NO_ROWS = np.zeros(0, dtype=np.int64)
Record = Any
"""pytest's record_property."""


# Probabilities of 0 and 1


@pytest.mark.parametrize("steepness", [1.0, 30.0, 1e4])
@CERTAIN.mark
def test_votes_of_all_or_nothing_give_finite_probabilities_in_file_and_reference(
    steepness: float,
) -> None:
    """One tree of pure leaves: every share is 0 or 1."""
    x = np.repeat(np.arange(4.0, dtype=np.float32)[:, None], 6, axis=1)
    forest = ExtraTreesClassifier(1, bootstrap=False, random_state=0).fit(
        x, np.arange(4)
    )
    head = Head(
        "situation",
        SITUATIONS,
        forest,
        Calibration(steepness * np.eye(4), np.linspace(-30.0, 0.0, 4)),
    )
    session = open_session(
        cut_learners(whole_graph(StepSpec(2, 50.0, "N", ("now",)), [head]))
    )
    (got,) = session.run(["p_situation"], {"features": x})
    expected = reference_probability(head, reference_votes(forest, x, 4))
    assert np.isfinite(got).all()
    np.testing.assert_allclose(got.sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(got, expected, atol=1e-5)


@CERTAIN.mark
def test_shares_that_are_always_right_are_calibrated_to_less_than_certainty() -> None:
    label = np.arange(400) % 4
    fitted = fit_calibration(np.eye(4)[label], label)
    p = probability(np.eye(4), fitted)
    assert np.isfinite(fitted.weights).all()
    assert (p > 0.0).all()
    assert (p < 1.0).all()
    np.testing.assert_array_equal(p.argmax(axis=1), np.arange(4))


def probability(shares: FloatArray, calibration: Calibration) -> FloatArray:
    """As `reference_probability`, of shares."""
    forest = ExtraTreesClassifier(1).fit(np.zeros((4, 1)), np.arange(4))
    return reference_probability(
        Head("situation", SITUATIONS, forest, calibration),
        (1000 * shares).astype(np.int64),
    )


@CERTAIN.mark
def test_scores_of_exactly_0_and_1_rank_like_any_other() -> None:
    truth, groups = np.array([0, 0, 1, 1, 0, 1]), list("aabbcc")
    certain = prediction_scores(
        truth, np.array([0.0, 1.0, 1.0, 1.0, 0.0, 0.0]), groups, n_draws=20
    )
    assert certain.auc == roc_auc_score(truth, [0.1, 0.9, 0.9, 0.9, 0.1, 0.1])


@CERTAIN.unguarded
def test_bare_vote_shares_lose_everything_on_one_surprise_and_a_naive_softmax_is_nan(
    record_property: Record,
) -> None:
    label = np.array([0, 1, 2, 3] * 25 + [0])
    shares = np.eye(4)[
        [*label[:-1], 1]
    ]  # the last is a surprise: no vote for what it was
    with np.errstate(divide="ignore"):
        bare = -np.log(shares[np.arange(101), label])
    assert bare[-1] == np.inf
    calibrated = probability(shares, fit_calibration(shares, label))
    record_property("log_loss_once_calibrated", float(log_loss(label, calibrated)))
    with np.errstate(over="ignore", invalid="ignore"):
        naive = np.exp(np.array([1e4, 0.0]))
        assert np.isnan(naive / naive.sum()).any()


# Absent classes


@ABSENT.mark
def test_a_class_that_was_never_seen_is_given_no_probability_and_the_others_keep_theirs() -> (
    None
):
    rng = np.random.default_rng(0)
    label = rng.choice([0, 1, 3], 300)
    shares = 0.6 * np.eye(4)[label] + 0.4 * rng.dirichlet(np.ones(4), 300)
    p = probability(shares, fit_calibration(shares, label))
    assert p[:, 2].max() < 1e-9
    assert (p.argmax(axis=1) == label).mean() > 0.95


@pytest.mark.parametrize("present", [[2], [0, 3]])
@ABSENT.mark
def test_with_only_one_class_or_two_the_others_are_given_no_probability(
    present: list[int],
) -> None:
    label = np.resize(present, 60)
    p = probability(np.eye(4)[label], fit_calibration(np.eye(4)[label], label))
    np.testing.assert_array_equal(p.argmax(axis=1), label)
    assert np.delete(p, present, axis=1).max() < 1e-9


@ABSENT.unguarded
def test_scikit_learns_macro_f1_over_all_classes_counts_an_absent_one_as_zero(
    record_property: Record,
) -> None:
    truth = np.array([0, 1, 3] * 10)
    usual = f1_score(truth, truth, labels=range(4), average="macro", zero_division=0.0)
    record_property("macro_f1_of_a_perfect_answer", float(usual))
    assert usual == 0.75
    assert situation_scores(truth, truth, list("ab") * 15, n_draws=5).macro_f1 == 1.0


# Nothing to score


@EMPTY.mark
def test_figures_of_no_window_are_none_and_have_all_their_names() -> None:
    some = situation_scores(
        np.array([0, 1, 2, 3]), np.array([0, 1, 2, 3]), list("abab"), n_draws=5
    )
    none = situation_scores(NO_ROWS, NO_ROWS, [], n_draws=5)
    assert none.f1.keys() == some.f1.keys() == none.f1_ci.keys()
    assert none.macro_f1 is none.macro_f1_ci is None
    assert set(none.f1.values()) == set(none.f1_ci.values()) == {None}
    assert prediction_scores(NO_ROWS, np.zeros(0), []) == PredictionFigures()
    assert share_scores(np.zeros(0, np.bool_), []) == Share(None, None, 0)
    forest = ExtraTreesClassifier(2).fit([[0.0], [1.0]], [0, 1])
    assert reference_votes(forest, np.zeros((0, 1), np.float32), 2).shape == (0, 2)


PLAN = TrainingPlan(
    situation=ForestPlan(n_estimators=2), prediction=ForestPlan(n_estimators=2), folds=3
)


def two_tasks(
    first: str, second: str
) -> tuple[DataSet, dict[str, npt.NDArray[np.float32]]]:
    """A set of people a, b, c .., who have windows of the one task and of the other; two of each
    label a person."""
    names = sorted({*first, *second})
    recordings = [
        Recording(one, one, np.zeros((2, 3)), np.ones((2, 1), np.bool_), RATE_HZ, "N")
        for one in names
    ]

    def task(people: str, classes: tuple[str, ...]) -> LabelledRows:
        trial = np.repeat(
            [names.index(one) for one in people], 2 * len(classes)
        ).astype(np.int64)
        label = np.tile(np.arange(len(classes)), 2 * len(people))
        return LabelledRows(trial, np.zeros(len(trial), np.int64), label, classes)

    tasks = {
        "situations": task(first, SITUATIONS),
        "predict_250ms": task(second, ("no", "yes")),
    }
    data = DataSet(
        "made", recordings, tasks, RATE_HZ, "N", Preparation(), "made", True, ""
    )
    rng = np.random.default_rng(0)
    return data, {
        name: rng.normal(size=(len(rows), 3)).astype(np.float32)
        for name, rows in tasks.items()
    }


@pytest.mark.parametrize(
    ("first", "second"), [("abcdef", "ab"), ("abc", "abcdef"), ("abcdef", "abcdefgh")]
)
@EMPTY.mark
def test_a_fold_without_a_window_of_a_task_is_no_trouble_and_every_window_is_held_out_once(
    first: str, second: str
) -> None:
    data, features = two_tasks(first, second)
    held = cross_validate(data, features, PLAN, seed=1)
    for task, rows in data.tasks.items():
        assert held.votes[task].shape == (len(rows), len(rows.classes))
        assert (held.votes[task].sum(axis=1) > 0).all()


@EMPTY.mark
def test_a_fold_that_leaves_nothing_to_train_on_says_which_task() -> None:
    data, features = two_tasks("abcdef", "a")
    with pytest.raises(ClassMissing, match="predict_250ms: no window to train on"):
        cross_validate(data, features, PLAN)


@EMPTY.unguarded
def test_the_usual_figures_of_nothing_are_nan_with_a_warning_or_a_crash() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert np.isnan(np.mean(NO_ROWS == NO_ROWS))
    forest = ExtraTreesClassifier(2).fit([[0.0], [1.0]], [0, 1])
    with pytest.raises(ValueError, match="0 sample"):
        forest.apply(np.zeros((0, 1), np.float32))


# Labels that cannot be


@pytest.mark.parametrize("foreign", [UNKNOWN, 5, 99])
@FOREIGN.mark
def test_a_prediction_that_is_no_label_is_refused_by_its_number(foreign: int) -> None:
    with pytest.raises(LabelError, match=f"a prediction of {foreign}, not of 0..4"):
        situation_scores(np.array([0, 1, 2]), np.array([0, foreign, 2]), list("abc"))
    with pytest.raises(LabelError, match=f"a truth of {foreign}, not of 0..3"):
        situation_scores(np.array([0, foreign, 2]), np.array([0, 1, 2]), list("abc"))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@FOREIGN.mark
def test_a_score_that_is_no_number_is_refused(bad: float) -> None:
    with pytest.raises(NotANumber, match="1 of 3 scores are not finite"):
        prediction_scores(np.array([0, 1, 1]), np.array([0.5, bad, 1.0]), list("abc"))


@FOREIGN.unguarded
def test_counted_in_cells_an_answer_of_minus_one_is_an_answer_withheld_from_another_class() -> (
    None
):
    n, truth, predicted = 4, np.array([0, 1, 1]), np.array([0, 1, UNKNOWN])
    cells = np.bincount(truth * (n + 1) + predicted, minlength=n * (n + 1)).reshape(
        n, n + 1
    )
    assert cells[0].sum() == 2  # truth held only one 0
    assert cells[1].sum() == 1


# A slip that sticks and slides


def shaking() -> FloatArray:
    """[1000, 3] at 100 Hz: one slip of 0.4 s, in which the object sticks and slides; y follows 0.45
    s after x."""
    t_s = np.arange(1000) / RATE_HZ
    slip = (
        ((t_s >= 5.0) & (t_s < 5.4))
        * np.sin(2.0 * np.pi * 20.0 * t_s)
        * (np.sin(2.0 * np.pi * 5.0 * t_s) > 0.0)
    )
    both = np.stack([slip, np.roll(slip, 45), np.zeros(1000)], axis=1)
    return np.random.default_rng(0).normal(0.0, 0.002, (1000, 3)) + 0.5 * both


@COLLAR.mark
def test_a_slip_that_sticks_and_slides_is_one_critical_point() -> None:
    assert band_pass_rows(shaking(), RATE_HZ) == pytest.approx([500], abs=10)


@COLLAR.unguarded
def test_without_a_collar_such_a_slip_is_counted_again_with_every_swing(
    record_property: Record,
) -> None:
    envelope = band_pass_envelope(shaking(), RATE_HZ)[:, 0]
    above = envelope > 6.0 * np.median(envelope)
    edges = int((np.diff(above.astype(int)) == 1).sum())
    record_property("times_one_slip_crosses_the_threshold", edges)
    assert edges > 2


# Calibrations of the sensors


def field_calibration(matrix: npt.ArrayLike) -> FieldCalibration:
    whole = np.stack([0.01 * np.eye(3), np.asarray(matrix, dtype=np.float64)])
    meta = CalibrationOrigin("made up", "2026-01-02", "N", 100, np.full((2, 3), 0.1))
    return FieldCalibration(whole, None, np.zeros(2, dtype=np.bool_), meta)


ROW = [0.01, 0.002, -0.003]
SINGULAR_MATRICES: dict[str, list[list[float]]] = {
    "zero": [[0.0] * 3] * 3,
    "two rows alike": [ROW, ROW, [0.0, 0.0, 0.01]],
    "one row twice another": [ROW, [2 * x for x in ROW], [0.0, 0.0, 0.01]],
    "normal and shear alike": [ROW, [0.0] * 3, ROW],
    "rank two": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
    "rank two and subnormal": [
        [1e-310, 2e-310, 3e-310],
        [4e-310, 5e-310, 6e-310],
        [7e-310, 8e-310, 9e-310],
    ],
}


@pytest.mark.parametrize("name", SINGULAR_MATRICES)
@SINGULAR.mark
def test_a_singular_matrix_is_refused_and_its_sensor_named(
    name: str, tmp_path: Path
) -> None:
    path = write_calibration(
        tmp_path / "c.json", field_calibration(SINGULAR_MATRICES[name])
    )
    with pytest.raises(
        DataError,
        match=r"c\.json: matrix_n_per_ut of sensor 2 is singular.*holdfast calibrate",
    ):
        read_calibration(path)


@pytest.mark.parametrize(
    "matrix",
    [
        [[0.0] * 3, [0.0] * 3, ROW],
        [ROW, [0.0] * 3, [0.0, 0.0, 0.01]],
        [ROW, [0.0, 1e-9, 0.0], [0.0, 0.0, 1e6]],
    ],
    ids=["normal alone", "one shear axis", "axes of very different size"],
)
@SINGULAR.mark
def test_an_axis_that_was_never_loaded_is_a_row_of_zeros_and_not_singular(
    matrix: list[list[float]], tmp_path: Path
) -> None:
    there = field_calibration(matrix)
    back = read_calibration(write_calibration(tmp_path / "c.json", there))
    np.testing.assert_array_equal(back.matrix, there.matrix)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
@pytest.mark.parametrize("where", ["matrix_n_per_ut", "rest_ut"])
@SINGULAR.mark
def test_a_number_that_is_not_finite_is_refused_wherever_it_stands(
    number: str, where: str, tmp_path: Path
) -> None:
    there = replace(field_calibration(np.eye(3)), rest_ut=np.full((2, 3), 7.0))
    path = write_calibration(tmp_path / "c.json", there)
    content = json.loads(path.read_text("utf-8"))
    row = content[where][1][1] if where == "matrix_n_per_ut" else content[where][1]
    row[1] = 12345.0
    path.write_text(json.dumps(content).replace("12345.0", number), "utf-8")
    with pytest.raises(NotANumber, match=f"c.json: {where} holds .* not finite"):
        read_calibration(path)


@SINGULAR.unguarded
def test_a_finger_with_such_a_matrix_reads_nothing_under_any_load_or_one_force_as_another() -> (
    None
):
    field = np.random.default_rng(0).normal(0.0, 500.0, (100, 2, 3))
    dead = field_calibration(SINGULAR_MATRICES["zero"]).apply(field)[:, 1]
    assert not dead.any()
    alike = field_calibration(SINGULAR_MATRICES["normal and shear alike"]).apply(field)[
        :, 1
    ]
    np.testing.assert_array_equal(alike[:, 0], alike[:, 2])
