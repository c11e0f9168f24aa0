"""The preliminary study: what a window may see, who is on which side, and the thesis' numbers as
they were printed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from holdfast.core.errors import ClassMissing
from holdfast.data.recording import DataSet, Recording
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.edge_runtime.preparation import Preparation
from studies.thesis_preliminary import program
from studies.thesis_preliminary import study as learners
from studies.thesis_preliminary.cases import CASES
from studies.thesis_preliminary.points import KINDS, Points, points_of, windows
from studies.thesis_preliminary.published import LEARNERS
from studies.thesis_preliminary.study import MAKE, balanced, case_figures, repetitions

RATE_HZ, SENSORS = 60.0, 20
SHAPES = {"1": (7, 60), "2": (7, 40), "3": (7, 3), "4": (7, 60), "5": (7, 60)}
"""Of one window in the thesis, samples by columns."""
BY_NAME = {case.name: case for case in CASES}


def made_trial(number: int, rng: np.random.Generator, group: str) -> Recording:
    """A grasp at 2 s, a disturbance at 5 s, and at 7 s a slip: risky in every other trial, which
    jumps more."""
    n, risky = 600, number % 2 == 1
    load = np.clip((np.arange(n) - 120) / 12.0, 0.0, 1.0) * (np.arange(n) < 480)
    forces = np.zeros((n, SENSORS, 3))
    forces[..., 2] = load[:, None] * rng.uniform(0.5, 2.0, SENSORS)
    forces[..., 1] = 0.3 * forces[..., 2]
    forces[300:330, :, 1] -= 0.5 * forces[300:330, :, 2]
    forces[420:480, :, 0] += (1.5 if risky else 0.6) * forces[420:480, :, 2]
    forces += 0.01 * rng.standard_normal(forces.shape)
    phases = (
        Phase(0, 120, 0),
        Phase(120, 420, 1),
        Phase(420, 480, 3 if risky else 2),
        Phase(480, n, 0),
    )
    return Recording(
        f"trial_{number}",
        group,
        forces.reshape(n, -1),
        np.ones((n, SENSORS), dtype=np.bool_),
        RATE_HZ,
        "N",
        phases=phases,
        events=(RiskyEvent(7.0, None, 8.0),) if risky else (),
    )


def made_set(n_trials: int = 24, groups: int = 8) -> DataSet:
    rng = np.random.default_rng(0)
    recordings = [
        made_trial(k, rng, f"person_{k // 2 % groups}") for k in range(n_trials)
    ]
    return DataSet(
        "made",
        recordings,
        {},
        RATE_HZ,
        "N",
        Preparation(),
        "simulated",
        True,
        "Made up.",
    )


@pytest.fixture(scope="module")
def data() -> DataSet:
    return made_set()


@pytest.fixture(scope="module")
def points(data: DataSet) -> Points:
    return points_of(data)


def test_on_twenty_sensors_every_case_has_the_shape_of_the_thesis(data, points):
    for case in CASES:
        samples = windows(data, points, case.first, case.last)
        shape = case.features(samples, samples).shape
        assert shape == (len(points), *SHAPES[case.name])


@pytest.mark.parametrize("name", ["4", "5"])
def test_a_predicting_window_sees_neither_the_critical_sample_nor_what_follows(
    data, points, name
):
    """Everything from the point on may be anything, and the features stay; one sample earlier, and
    they do not."""
    case = BY_NAME[name]

    def features(from_point: int) -> np.ndarray:
        recordings = list(data.recordings)
        for k, row in zip(points.trial[:1], points.row[:1], strict=True):
            samples = recordings[k].samples.copy()
            samples[row + from_point :] = 1e6
            recordings[k] = replace(recordings[k], samples=samples)
        seen = windows(
            replace(data, recordings=recordings), points, case.first, case.last
        )[:1]
        return case.features(seen, seen)

    untouched = windows(data, points, case.first, case.last)[:1]
    np.testing.assert_array_equal(features(0), untouched)
    assert (features(-1) != untouched).any()
    assert untouched.shape[1] == 7


def test_a_point_is_what_the_truth_says_around_it_and_not_what_a_sensor_does(
    data, points
):
    assert set(points.kind) == set(range(len(KINDS)))
    for trial, row, kind in zip(points.trial, points.row, points.kind, strict=True):
        near = [
            p.situation
            for p in data.recordings[trial].phases
            if p.first <= row + 3 and row - 3 < p.stop
        ]
        assert {0: 1, 1: 1, 2: 2, 3: 3}[int(kind)] == max(near)
        assert (kind == 1) == (max(near) == 1 and row >= 120 + 90)


@pytest.mark.parametrize("name", ["2", "3"])
def test_what_a_case_learns_it_learns_from_the_training_windows_alone(name):
    rng = np.random.default_rng(0)
    training, test = rng.normal(size=(20, 7, 18)), rng.normal(size=(8, 7, 18))
    features = BY_NAME[name].features
    np.testing.assert_allclose(
        features(training, test)[:3], features(training, test[:3]), rtol=1e-12
    )
    assert (features(3.0 * training[:5], test) != features(training, test)).any()


@pytest.mark.parametrize("name", ["1", "5"])
def test_no_group_is_on_both_sides(points, name):
    draws = repetitions(points, BY_NAME[name], seed=0)
    assert len(draws) == 5
    for draw in draws:
        assert not set(points.group[draw.train]) & set(points.group[draw.test])
        assert 0 < len(draw.test) < len(draw.train)
        assert not set(draw.train) & set(draw.test)


def test_classes_are_equal_and_so_are_the_kinds_within_one():
    kind = np.repeat(np.arange(4), [50, 20, 30, 45])
    two = np.bincount(kind[balanced(kind, BY_NAME["1"], 0)])
    assert two.tolist() == [15, 15, 15, 45]
    assert np.bincount(kind[balanced(kind, BY_NAME["5"], 0)]).tolist() == [
        20,
        20,
        20,
        20,
    ]
    with pytest.raises(ClassMissing, match="safe slip"):
        balanced(kind[kind != 2], BY_NAME["1"], 0)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The learners themselves, with a few trees and neurons each."""
    few = {
        "n_estimators": 10,
        "max_iter": 10,
        "mlpclassifier__hidden_layer_sizes": (4,),
        "mlpclassifier__tol": 0.02,
    }

    def small(make: Callable[[int], Any]) -> Callable[[int], Any]:
        def made(seed: int) -> Any:
            learner = make(seed)
            known = learner.get_params()
            return learner.set_params(
                **{k: value for k, value in few.items() if k in known}
            )

        return made

    monkeypatch.setattr(
        learners, "MAKE", {name: small(make) for name, make in MAKE.items()}
    )


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", ["1", "4"])
def test_the_same_seed_gives_the_same_figures_and_another_others(data, points, name):
    first, again, other = (
        case_figures(data, points, BY_NAME[name], seed) for seed in (0, 0, 1)
    )
    assert first == again
    assert first != other
    assert set(first.accuracy) == set(LEARNERS) == set(MAKE)


@pytest.mark.usefixtures("quick")
def test_labels_drawn_by_lot_are_answered_by_chance():
    """No way round the split: where there is nothing to learn, nothing is learned."""
    data = made_set(48, 12)
    points = points_of(data)
    lots = np.random.default_rng(0).permutation(points.kind)
    figures = case_figures(data, replace(points, kind=lots), BY_NAME["1"], seed=0)
    for score in figures.accuracy.values():
        assert score.mean == pytest.approx(0.5, abs=0.2)
    learned = case_figures(data, points, BY_NAME["1"], seed=0)
    assert learned.accuracy["random forest"].mean > 0.75


def test_the_simulated_hand_of_twenty_is_studied_as_it_is_written(tmp_path: Path):
    """From card to case: 60 channels, every kind of point, a truth that is the physics'."""
    from holdfast.simulation.scenes.folder import write_set
    from holdfast.simulation.scenes.scene import Scene
    from holdfast.simulation.scenes.scene_file import read_scene_file

    card = replace(read_scene_file("twenty-sensors"), step_s=0.017)
    write_set(Scene(card, 0), tmp_path / "scene", 40)
    data = program.read_scene(tmp_path / "scene")
    assert (data.n_sensors, data.rate_hz) == (20, 60.0)
    found = points_of(data)
    assert set(found.kind) == set(range(len(KINDS)))
    assert windows(data, found, -3, 3).shape[1:] == (7, 60)
    assert len(set(found.group)) > 20
