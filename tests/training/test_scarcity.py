"""Too little data to learn from is a warning that says what to do."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from made_set import made_set, task_of

from holdfast.core.contract import CLASSES
from holdfast.data.recording import DataSet
from holdfast.training.fitting import FEWEST_WINDOWS, FewWindows, warn_of_scarcity


def a_set(counts: dict[str, int], n_people: int) -> DataSet:
    """A set with so many windows of each class, dealt to so many people."""
    each = [counts.get(name, 60) for name in CLASSES]
    label = np.repeat(np.arange(len(CLASSES)), each)
    trial = np.arange(len(label)) % n_people
    return made_set(n_people, {"classes": task_of(trial, label, CLASSES)})


@pytest.mark.parametrize(
    "counts",
    [{"risky_slip_heavy": FEWEST_WINDOWS}, {"safe_slip_light": 0}],
    ids=["just enough windows", "a class without a window, which is not learned"],
)
def test_a_set_with_enough_windows_and_people_warns_of_nothing(
    counts: dict[str, int],
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_scarcity(a_set(counts, 3))


def test_scarce_classes_are_named_with_their_counts_and_what_to_do() -> None:
    scarce = a_set({"risky_slip_heavy": 49, "safe_slip_light": 3}, 3)
    with pytest.warns(FewWindows) as caught:
        warn_of_scarcity(scarce)
    (warning,) = caught
    text = str(warning.message)
    assert "safe_slip_light (3), risky_slip_heavy (49)" in text
    assert "made: fewer than 50 windows" in text
    assert "grasp_light" not in text
    assert "next: record or simulate more trials" in text
