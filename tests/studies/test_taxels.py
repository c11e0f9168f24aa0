"""Six taxels of a pad, the input of the timing-only baseline, and the leaky split."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from holdfast.training.datasets import human_slip_uskin
from holdfast.training.recording import DataSet
from studies.folds import leaky_folds
from studies.real.clock import clock_features


@pytest.fixture(scope="module")
def whole(real_set: Callable[[str], Path]) -> DataSet:
    return human_slip_uskin.load(real_set("human_slip_uskin"), channels=48)


def test_the_clock_counts_from_the_last_rise_through_one_newton(whole: DataSet) -> None:
    rows = whole.tasks["situations"].take(np.arange(500))
    clock = clock_features(whole, rows)
    for trial, row, (frames, force_n) in zip(rows.trial, rows.row, clock, strict=True):
        z = whole.recordings[trial].samples[:, 2::3].sum(axis=1)
        rises = np.flatnonzero((z[1 : row + 1] >= 1.0) & (z[:row] < 1.0)) + 1
        assert frames == (row - rises[-1] if len(rises) else -1)
        assert force_n == pytest.approx(z[row], abs=1e-12)


def test_the_usual_six_taxels_have_no_neighbours_and_leave_no_gap() -> None:
    places = np.stack(np.divmod(np.arange(16), 4), axis=1)
    steps = np.abs(places[:, None] - places).sum(axis=2)
    chosen = [taxel - 1 for taxel in human_slip_uskin.SPREAD_TAXELS]
    among = steps[np.ix_(chosen, chosen)]
    assert among[~np.eye(6, dtype=np.bool_)].min() == 2
    assert steps[:, chosen].min(axis=1).max() == 1


def test_the_card_has_the_six_taxels_where_the_pad_has_them(
    whole: DataSet, real_set: Callable[[str], Path]
) -> None:
    six = human_slip_uskin.load(real_set("human_slip_uskin"))
    first = six.recordings[0].samples
    np.testing.assert_array_equal(first[:, :3], whole.recordings[0].samples[:, 3:6])
    assert six.hand is not None
    sensed = [contact for contact in six.hand.contacts if contact.sensed]
    taxels = human_slip_uskin.SPREAD_TAXELS
    assert [contact.name for contact in sensed] == [f"taxel-{k}" for k in taxels]
    down, right = np.divmod(np.array(taxels) - 1, 4)
    along = np.array([contact.along_mm for contact in sensed])
    across = np.array([contact.across_mm for contact in sensed])
    np.testing.assert_allclose(along, 4.7 * (1.5 - down))
    np.testing.assert_allclose(across, 4.7 * (right - 1.5))


def test_the_leaky_split_tests_every_window_once_and_shares_people() -> None:
    folds = leaky_folds(100, 5, seed=2)
    assert sorted(np.concatenate([test for _, test in folds])) == list(range(100))
    groups = np.arange(100) // 10
    assert all(set(groups[test]) & set(groups[train]) for train, test in folds)
