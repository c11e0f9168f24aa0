"""A data set of windows alone: recordings without content, as fitting and metrics need them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from holdfast.data.recording import DataSet, LabelledRows, Recording
from holdfast.edge_runtime.preparation import Preparation


def made_set(n_people: int, tasks: dict[str, LabelledRows]) -> DataSet:
    """A recording of each person, `person 0` first; the set is in N, at 50 Hz."""
    values, valid = np.zeros((2, 3)), np.ones((2, 1), dtype=np.bool_)
    recordings = [
        Recording(f"trial {k}", f"person {k}", values, valid, 50.0, "N")
        for k in range(n_people)
    ]
    return DataSet(
        "made",
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


def task_of(
    trial: npt.NDArray[np.int64],
    label: npt.NDArray[np.int64],
    classes: tuple[str, ...],
) -> LabelledRows:
    """A window of each label at the first row of its trial."""
    return LabelledRows(trial, np.zeros_like(trial), label, classes)
