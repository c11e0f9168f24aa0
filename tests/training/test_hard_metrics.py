"""Hard cases of calibration and metrics: certainty, absence, matrices that are singular."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hard_marks import ABSENT, CERTAIN, EMPTY, FOREIGN, SINGULAR
from made_set import made_set, task_of
from sklearn.ensemble import ExtraTreesClassifier

from holdfast.core.contract import SITUATIONS, FloatArray
from holdfast.core.errors import DataError, LabelError
from holdfast.data.metrics import PredictionFigures, prediction_scores, situation_scores
from holdfast.data.recording import DataSet, LabelledRows
from holdfast.drivers.calibration import Calibration as FieldCalibration
from holdfast.drivers.calibration import read_calibration, write_calibration
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import open_session
from holdfast.export.exporting import whole_graph
from holdfast.export.verify import cut_learners
from holdfast.step.heads import Head, VoteCalibration, reference_probability
from holdfast.step.learner import Learner, reference_votes
from holdfast.step.spec import StepSpec
from holdfast.training.crossval import cross_validate, fit_calibration
from holdfast.training.plan import ForestPlan, TrainingPlan

NO_ROWS = np.zeros(0, dtype=np.int64)


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
        Learner(forest),
        VoteCalibration(steepness * np.eye(4), np.linspace(-30.0, 0.0, 4)),
    )
    # The learner alone, without what force decides after it.
    spec = StepSpec(2, 50.0, "N", ("now",), force_decides=False)
    session = open_session(cut_learners(whole_graph(spec, [head])))
    (got,) = session.run(["p_situation"], {"features": x})
    expected = reference_probability(head, reference_votes(Learner(forest), x, 4))
    assert np.isfinite(got).all()
    np.testing.assert_allclose(got.sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(got, expected, atol=1e-5)


def probability(shares: FloatArray, calibration: VoteCalibration) -> FloatArray:
    """As `reference_probability`, of shares."""
    forest = ExtraTreesClassifier(1).fit(np.zeros((4, 1)), np.arange(4))
    return reference_probability(
        Head("situation", SITUATIONS, Learner(forest), calibration),
        (1000 * shares).astype(np.int64),
    )


# Absent classes


@pytest.mark.parametrize("present", [[2], [0, 3], [0, 1, 3]])
@ABSENT.mark
def test_classes_never_seen_are_given_no_probability_and_the_others_keep_theirs(
    present: list[int],
) -> None:
    label = np.resize(present, 60)
    p = probability(np.eye(4)[label], fit_calibration(np.eye(4)[label], label))
    np.testing.assert_array_equal(p.argmax(axis=1), label)
    assert np.delete(p, present, axis=1).max() < 1e-9


# Nothing to score


@EMPTY.mark
def test_figures_of_no_window_are_none_and_have_all_their_names() -> None:
    none = situation_scores(NO_ROWS, NO_ROWS, [], n_draws=5)
    assert none.macro_f1 is none.macro_f1_ci is None
    assert none.f1 == none.f1_ci == dict.fromkeys(SITUATIONS)
    assert prediction_scores(NO_ROWS, np.zeros(0), []) == PredictionFigures()
    forest = ExtraTreesClassifier(2).fit([[0.0], [1.0]], [0, 1])
    assert reference_votes(Learner(forest), np.zeros((0, 1), np.float32), 2).shape == (
        0,
        2,
    )


PLAN = TrainingPlan(
    situation=ForestPlan(n_estimators=2), prediction=ForestPlan(n_estimators=2), folds=3
)


def two_tasks(
    first: str, second: str
) -> tuple[DataSet, dict[str, npt.NDArray[np.float32]]]:
    """A set of people a, b, c .., who have windows of the one task and of the other; two of each
    label a person."""
    names = sorted({*first, *second})

    def task(people: str, classes: tuple[str, ...]) -> LabelledRows:
        numbers = np.array([names.index(one) for one in people])
        label = np.tile(np.arange(len(classes)), 2 * len(people))
        return task_of(np.repeat(numbers, 2 * len(classes)), label, classes)

    tasks = {
        "situations": task(first, SITUATIONS),
        "predict_250ms": task(second, ("no", "yes")),
    }
    rng = np.random.default_rng(0)
    features = {
        name: rng.normal(size=(len(rows), 3)).astype(np.float32)
        for name, rows in tasks.items()
    }
    return made_set(len(names), tasks), features


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


# Labels that cannot be


@pytest.mark.parametrize("foreign", [UNKNOWN, 5])
@FOREIGN.mark
def test_a_prediction_that_is_no_label_is_refused_by_its_number(foreign: int) -> None:
    right, wrong = np.array([0, 1, 2]), np.array([0, foreign, 2])
    with pytest.raises(LabelError, match=f"a prediction of {foreign}, not of 0..4"):
        situation_scores(right, wrong, list("abc"))
    with pytest.raises(LabelError, match=f"a truth of {foreign}, not of 0..3"):
        situation_scores(wrong, right, list("abc"))


# Calibrations of the sensors


def field_calibration(matrix: npt.ArrayLike) -> FieldCalibration:
    whole = np.stack([0.01 * np.eye(3), np.asarray(matrix, dtype=np.float64)])
    rest_ut = np.zeros((2, 3))
    words = ("made up", "2026-01-02", "N", 100)
    return FieldCalibration(whole, rest_ut, np.zeros(2, np.bool_), *words, rest_ut)


ROW = [0.01, 0.002, -0.003]


@pytest.mark.parametrize(
    "matrix",
    [
        [ROW, [0.0] * 3, ROW],
        [[1e-310, 2e-310, 3e-310], [4e-310, 5e-310, 6e-310], [7e-310, 8e-310, 9e-310]],
    ],
    ids=["normal and shear alike", "rank two and subnormal"],
)
@SINGULAR.mark
def test_a_singular_matrix_is_refused_and_its_sensor_named(
    matrix: list[list[float]], tmp_path: Path
) -> None:
    path = write_calibration(tmp_path / "c.json", field_calibration(matrix))
    with pytest.raises(
        DataError,
        match=r"c\.json: matrix_n_per_ut of sensor 2 is singular.*holdfast calibrate",
    ):
        read_calibration(path)
