"""Too little data to learn from is a warning that says what to do."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from holdfast.core.contract import CLASSES
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.fitting import (
    FEWEST_WINDOWS,
    FewGroups,
    FewWindows,
    warn_of_scarcity,
)
from holdfast.training.recording import DataSet, LabelledRows, Recording


def a_set(counts: dict[str, int], n_groups: int) -> DataSet:
    """A set with so many windows of each class, dealt to so many people."""
    label = np.repeat(
        np.arange(len(CLASSES)), [counts.get(name, 60) for name in CLASSES]
    )
    trial = np.arange(len(label)) % n_groups
    samples, valid = np.zeros((2, 3)), np.ones((2, 1), dtype=np.bool_)
    recordings = [
        Recording(str(k), f"person {k}", samples, valid, 50.0, "N")
        for k in range(n_groups)
    ]
    tasks = {"classes": LabelledRows(trial, np.zeros_like(trial), label, CLASSES)}
    return DataSet(
        "mine",
        recordings,
        tasks,
        50.0,
        "N",
        Preparation(),
        "made",
        True,
        "",
        group_kind="person",
    )


def test_a_set_with_enough_windows_and_people_warns_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_scarcity(a_set({"risky_slip_heavy": FEWEST_WINDOWS}, n_groups=3))


def test_scarce_classes_are_named_with_their_counts_and_what_to_do() -> None:
    scarce = a_set({"risky_slip_heavy": 49, "safe_slip_light": 3}, n_groups=3)
    with pytest.warns(FewWindows) as caught:
        warn_of_scarcity(scarce)
    (warning,) = caught
    text = str(warning.message)
    assert "safe_slip_light (3), risky_slip_heavy (49)" in text
    assert "mine: fewer than 50 windows" in text
    assert "grasp_light" not in text
    assert "next: record or simulate more trials" in text


def test_the_undersampled_set_is_left_out_before_more_is_recorded() -> None:
    with pytest.warns(FewWindows, match="next: leave out --windows thesis, or record"):
        warn_of_scarcity(
            a_set(dict.fromkeys(CLASSES, 3), n_groups=3), undersampled=True
        )


def test_a_class_that_the_set_lacks_by_its_nature_is_not_scarce() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_scarcity(a_set({"safe_slip_light": 0}, n_groups=3))


def test_two_people_are_too_few_to_say_how_a_third_one_fares() -> None:
    with pytest.warns(FewGroups, match="two people only; .*; next: record more people"):
        warn_of_scarcity(a_set({}, n_groups=2))
