"""Labelled windows and their balance, and the faults of the thesis that must not come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import CLASSES, GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP
from holdfast.core.trial_layout import MASSES_G, is_heavy
from holdfast.data.datasets import load
from holdfast.data.fixture import write_fixture
from holdfast.data.recording import DataSet, Recording
from holdfast.data.timeline import Phase
from holdfast.data.windows import (
    COLUMNS,
    STRATA,
    TimedTrial,
    labelled_rows,
    undersample,
    windows_of,
)
from holdfast.step.spec import HISTORY_S, StepSpec, window_samples
from holdfast.training.plan import hand_plan

RATE_HZ = 50.0


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    folder = tmp_path_factory.mktemp("fixture")
    write_fixture(folder)
    return load(folder, windows="thesis")


@pytest.fixture(scope="module")
def balanced(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    """The same set by default: dense windows, whose classes weigh the same in training."""
    folder = tmp_path_factory.mktemp("balanced")
    write_fixture(folder)
    return load(folder)


def shaken(*times_s: float, lasts_s: float = 12.0) -> Recording:
    """A recording of one sensor that is shaken at these times."""
    t_s = np.arange(round(lasts_s * RATE_HZ)) / RATE_HZ
    samples = np.random.default_rng(0).normal(0.0, 0.002, (len(t_s), 3))
    for time_s in times_s:
        on = (t_s >= time_s) & (t_s < time_s + 0.1)
        samples[:, 0] += on * np.sin(2 * np.pi * 15.0 * (t_s - time_s))
    valid = np.ones((len(t_s), 1), dtype=np.bool_)
    return Recording("a", "a", samples, valid, RATE_HZ, "N", "soft-ball", "pass")


def phases(*marks: tuple[float, int], stop_s: float = 12.0) -> tuple[Phase, ...]:
    stops = [start_s for start_s, _ in marks[1:]] + [stop_s]
    return tuple(
        Phase(round(start_s * RATE_HZ), round(end_s * RATE_HZ), situation)
        for (start_s, situation), end_s in zip(marks, stops, strict=True)
    )


def timed(
    times: tuple[Phase, ...], *shaken_s: float, heavy: bool | None = False
) -> TimedTrial:
    return TimedTrial(replace(shaken(*shaken_s), phases=times), heavy)


def slips(windows: pd.DataFrame) -> list[tuple[int, int]]:
    """(row, label) of the windows that come from critical points."""
    critical = windows[~windows["source"].isin(["keep", "nothing"])]
    return list(zip(critical["row"].tolist(), critical["label"].tolist(), strict=True))


@st.composite
def tables(draw: st.DrawFn) -> pd.DataFrame:
    """A table of windows with every class, of any imbalance."""
    cell = st.tuples(
        st.sampled_from(["a", "b", "c"]),
        st.sampled_from(["pass", "pull"]),
        st.sampled_from(["keep", "both"]),
    )
    lines: list[tuple[int | str, ...]] = []
    for label in range(len(CLASSES)):
        for cell_of_window in draw(st.lists(cell, min_size=1, max_size=25)):
            lines.append((len(lines) % 7, len(lines), label, *cell_of_window))
    return pd.DataFrame(lines, columns=COLUMNS)


@given(windows=tables(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_all_classes_have_the_same_count_and_their_cells_give_as_equally_as_they_can(
    windows: pd.DataFrame, seed: int
) -> None:
    balanced = undersample(windows, seed)
    counts = labelled_rows(balanced).class_counts().values()
    assert set(counts) == {min(labelled_rows(windows).class_counts().values())}
    assert not balanced.duplicated().any()
    made_up = len(balanced) - len(balanced.merge(windows, how="inner"))
    assert not made_up
    keys = ["label", *STRATA]
    had = windows.groupby(keys).size()
    gave = balanced.groupby(keys).size().reindex(had.index, fill_value=0)
    for label in range(len(CLASSES)):
        most = gave[label].max()
        unspent = gave[label][gave[label] < had[label]]
        assert (unspent >= most - 1).all(), "a cell gave less although it had more"


@pytest.mark.parametrize(
    ("rate_hz", "rows"), [(50.0, 6), (58.9, 6), (150.0, 16), (300.0, 31), (8.0, 2)]
)
def test_a_window_spans_a_tenth_of_a_second_at_every_rate(
    rate_hz: float, rows: int
) -> None:
    assert (
        window_samples(rate_hz) == rows == StepSpec(6, rate_hz, "N", ()).window_samples
    )


def test_a_point_bears_the_situation_of_the_phase_it_falls_in() -> None:
    times = phases((0, NOTHING), (3, GRASP), (7, RISKY_SLIP), (8, NOTHING))
    trial = timed(times, 3.2, 7.3, 9.5, heavy=True)
    assert [label for _, label in slips(windows_of([trial], "natural"))] == [3, 7]


def test_at_an_edge_the_higher_situation_takes_the_points_within_one_window() -> None:
    times = phases((0, NOTHING), (3, GRASP), (7, SAFE_SLIP), (8, NOTHING))
    found = slips(windows_of([timed(times, 2.92, 6.92, 8.02)], "natural"))
    assert [label for _, label in found] == [2, 4, 4]
    early = slips(windows_of([timed(times, 2.6, 6.6, 8.4)], "natural"))
    assert [label for _, label in early] == [2], (
        "before contact and after the release a point is no window"
    )


def test_keep_windows_show_steady_holding_before_and_between_actions() -> None:
    first = phases((0, NOTHING), (3, GRASP), (7, SAFE_SLIP), stop_s=8.0)
    second = phases((8, GRASP), (10, SAFE_SLIP), (11, NOTHING))
    times = (*first, *second)

    def kept(*shaken_s: float) -> pd.DataFrame:
        windows = windows_of([timed(times, *shaken_s)], "natural")
        return windows[windows["source"] == "keep"]

    assert (kept(7.2)["label"] == 2).all()
    assert kept(7.2)["row"].tolist() == [250, 334, 450, 484]
    assert kept(5.1, 7.2)["row"].tolist() == [334, 450, 484]


def test_every_window_lies_inside_its_trial_and_no_row_is_used_twice(
    data: DataSet,
) -> None:
    task = data.tasks["classes"]
    lengths = np.array([len(recording.samples) for recording in data.recordings])
    assert (task.row >= window_samples(data.rate_hz) - 1).all()
    assert (task.row < lengths[task.trial]).all()
    assert len(set(zip(task.trial.tolist(), task.row.tolist(), strict=True))) == len(
        task
    )


def test_balanced_windows_have_every_risky_sample_and_throw_none_away(
    data: DataSet, balanced: DataSet
) -> None:
    counts = balanced.tasks["classes"].class_counts()
    undersampled = data.tasks["classes"].class_counts()
    for name in ("risky_slip_light", "risky_slip_heavy"):
        assert counts[name] == balanced.notes["samples"][name], (
            "a trial's truth is exact"
        )
    assert all(counts[name] > 2 * undersampled[name] for name in counts)
    assert len(set(counts.values())) == len(CLASSES), (
        "none is cut to the size of another"
    )


def test_no_balanced_window_ends_before_the_history_is_whole(balanced: DataSet) -> None:
    assert balanced.tasks["classes"].row.min() == round(HISTORY_S * balanced.rate_hz)


@pytest.mark.parametrize("size", ["tiny", "default"])
def test_all_eight_classes_of_the_balanced_windows_weigh_the_same_in_a_forest(
    balanced: DataSet, size: str
) -> None:
    plan = replace(hand_plan(size).forest_for("classes"), n_estimators=1)
    task = balanced.tasks["classes"]
    features = np.random.default_rng(0).normal(size=(len(task), 3)).astype(np.float32)
    forest = plan.build(0, n_jobs=1).fit(features, task.label)
    at_the_root = forest.estimators_[0].tree_.value[0, 0]
    np.testing.assert_allclose(at_the_root / at_the_root.sum(), 1.0 / len(CLASSES))


def test_labels_follow_the_mass_of_the_object_and_no_hand_over_is_a_risky_slip(
    data: DataSet,
) -> None:
    task = data.tasks["classes"]
    for trial, label in zip(task.trial, task.label, strict=True):
        recording = data.recordings[trial]
        if recording.object_name is not None:
            assert label % 2 == is_heavy(MASSES_G[recording.object_name])
        if recording.action in ("pass", "put-down"):
            assert label // 2 != RISKY_SLIP
