"""Whether a model's outputs can be true, checked on its golden sequences when it is opened."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import NotAModel
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.onnx_rules import votes_in_all

ROUNDING = 1e-5
"""A probability is a float32, and so is a sum of eight of them."""


def require_in_range(answers: Outputs, card: ModelCard, path: str | Path) -> None:
    """Raise NotAModel that names the outputs whose numbers are out of range."""
    wrong = sorted({*_wrong(answers, card)})
    if wrong:
        raise NotAModel(
            f"its answers are out of range: {', '.join(wrong)}",
            where=path,
            cause="the graph was altered and sealed again",
            next_step="export the model again with holdfast export",
        )


def _wrong(answers: Outputs, card: ModelCard) -> Iterator[str]:
    if not np.isin(answers["situation"], np.arange(len(SITUATIONS))).all():
        yield "situation"
    if not np.isin(
        answers["usable_sensors"], np.arange(card.n_channels // 3 + 1)
    ).all():
        yield "usable_sensors"
    for head in ("situation", *card.heads):
        name = "votes" if head == "situation" else f"votes_{head}"
        votes, in_all = answers[name], votes_in_all(card.raw["heads"][head])
        whole = (votes >= 0) & (votes == np.floor(votes))
        if not whole.all() or (votes.sum(axis=1, dtype=np.float64) != in_all).any():
            yield name
    for name in ("p_situation", *(("p_class",) if card.has_weight else ())):
        if not (
            _probable(answers[name])
            and (np.abs(answers[name].sum(axis=1) - 1.0) <= ROUNDING).all()
        ):
            yield name
    yield from (name for name in card.heads if not _probable(answers[name]))


def _probable(values: np.ndarray) -> bool:
    return bool(((values >= 0.0) & (values <= 1.0 + ROUNDING)).all())
