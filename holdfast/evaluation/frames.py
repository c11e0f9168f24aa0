"""Answers and figures as pandas data frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.method_names import display_name
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.training.recording import Recording

UNKNOWN, ALL_SETS = "unknown", "all sets"
LOW_HIGH = ("low", "high")


def to_frame(of: Evaluation | Sequence[ModelOutputs]) -> pd.DataFrame:
    """The answers of `run_model`, a line a sample, or an evaluation, a line a set and method.

    Answers: trial_id, person, object, action, t_s, truth (None without a label), state, a p_ for
    each situation, risky_share of the votes, class (None where the model knows no weight).
    Figures: set, method, then each figure; an interval as _low and _high, parts joined by a dot.
    """
    if isinstance(of, Evaluation):
        return pd.json_normalize(list(_figures(of)))
    return pd.concat([_answers(one) for one in of], ignore_index=True)


def _answers(of: ModelOutputs) -> pd.DataFrame:
    one = of.recording
    lines = {
        "trial_id": one.trial_id,
        "person": one.person,
        "object": one.object_name,
        "action": one.action,
        "t_s": np.arange(len(of.situation)) / one.rate_hz,
        "truth": _named(_truth(one, len(of.situation)), SITUATIONS, None),
        "state": _named(of.situation, SITUATIONS, UNKNOWN),
        **{f"p_{name}": of.p_situation[:, k] for k, name in enumerate(SITUATIONS)},
        "risky_share": of.risky_permille / 1000.0,
        "class": _named(of.eight, CLASSES, None),
    }
    return pd.DataFrame(lines)


def _truth(recording: Recording, n_rows: int) -> npt.NDArray[np.int64]:
    """[T] situation of each row by the phases, -1 for none."""
    truth = np.full(n_rows, -1)
    for phase in recording.phases:
        truth[phase.first : phase.stop] = phase.situation
    return truth


def _named(
    codes: npt.NDArray[np.int64], names: Sequence[str], without: str | None
) -> npt.NDArray[np.object_]:
    """[T] names of codes; a code of -1 has none."""
    return np.array([*names, without], dtype=object)[codes]


def _figures(of: Evaluation) -> Iterator[dict[str, Any]]:
    rows = {name: one.rows for name, one in of.sets.items()}
    for name, methods in (
        rows | ({ALL_SETS: of.rows} if len(rows) > 1 else {})
    ).items():
        for method, figures in methods.items():
            yield {
                "set": name,
                "method": display_name(method),
                **_flat(asdict(figures)),
            }


def _flat(figures: dict[str, Any]) -> dict[str, Any]:
    """The same with an interval's two ends under names of their own, at every depth."""
    flat: dict[str, Any] = {}
    for name, value in figures.items():
        if str(name).endswith("_ci"):
            ends = value or (None, None)
            flat |= {
                f"{str(name)[:-3]}_{end}": at
                for end, at in zip(LOW_HIGH, ends, strict=True)
            }
        else:
            flat[str(name)] = _flat(value) if isinstance(value, dict) else value
    return flat
