"""Answers and figures as pandas data frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.formats import display_name
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.states import labels_everywhere

UNKNOWN = "unknown"
ALL_SETS = "all sets"


def to_frame(of: Evaluation | Sequence[ModelOutputs]) -> pd.DataFrame:
    """The answers of `run_model`, a line a sample, or an evaluation, a line a set and method.

    Answers: trial_id, person, object, action, t_s, truth (None without a label), state, a p_ for
    each situation, risky_share of the votes, class (None where the model knows no weight).
    Figures: set, method, then each figure; an interval as _low and _high, parts joined by a dot.
    """
    if isinstance(of, Evaluation):
        return pd.json_normalize(_figures(of))
    return pd.concat([_answers(one) for one in of], ignore_index=True)


def _answers(of: ModelOutputs) -> pd.DataFrame:
    recording = of.recording
    n_rows = len(of.situation)
    # Between labelled phases there is no truth, which is None in the column.
    truth = labels_everywhere(recording.phases, n_rows)
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


def _figures(of: Evaluation) -> list[dict[str, Any]]:
    rows = {name: one.rows for name, one in of.sets.items()}
    # Of one set both would be the same lines.
    if len(rows) > 1:
        rows[ALL_SETS] = of.rows

    lines = []
    for name, methods in rows.items():
        for method, figures in methods.items():
            line = {"set": name, "method": display_name(method)}
            lines.append(line | _flat(asdict(figures)))

    return lines


def _flat(figures: dict[str, Any]) -> dict[str, Any]:
    """The same with an interval's two ends under names of their own, at every depth."""
    flat: dict[str, Any] = {}
    for name, value in figures.items():
        # A pair in one cell could be neither sorted nor averaged.
        if name.endswith("_ci"):
            short = name.removesuffix("_ci")
            low, high = value or (None, None)
            flat[f"{short}_low"] = low
            flat[f"{short}_high"] = high
        else:
            flat[name] = _flat(value) if isinstance(value, dict) else value

    return flat
