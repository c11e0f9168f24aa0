"""Answers as a pandas data frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.states import labels_of

UNKNOWN = "unknown"


def to_frame(of: Sequence[ModelOutputs]) -> pd.DataFrame:
    """The answers of `run_model`, a line a sample.

    Columns: trial_id, person, object, action, t_s, truth (None without a label), state, a p_ for
    each situation, risky_share of the votes, class (None where the model knows no weight).
    """
    return pd.concat([_answers(one) for one in of], ignore_index=True)


def _answers(of: ModelOutputs) -> pd.DataFrame:
    recording = of.recording
    n_rows = len(of.situation)
    # Between labelled phases there is no truth, which is None in the column.
    truth = labels_of(of)
    frame = pd.DataFrame(
        {
            "trial_id": recording.trial_id,
            "person": recording.person,
            "object": recording.object_name,
            "action": recording.action,
            "t_s": np.arange(n_rows) / recording.rate_hz,
            "truth": _named(truth, SITUATIONS, None),
            "state": _named(of.situation, SITUATIONS, UNKNOWN),
        }
    )
    for k, name in enumerate(SITUATIONS):
        frame[f"p_{name}"] = of.p_situation[:, k]

    # Thousandths become a share, like the probabilities next to it.
    frame["risky_share"] = of.risky_permille / 1000.0
    frame["class"] = _named(of.eight, CLASSES, None)
    return frame


def _named(
    codes: npt.NDArray[np.int64], names: Sequence[str], without: str | None
) -> npt.NDArray[np.object_]:
    """[T] names of codes; a code of -1 has none."""
    # numpy reads the index -1 from the end, where the missing name stands.
    with_none = np.array([*names, without], dtype=object)
    return with_none[codes]
