"""A model file, opened: its seal, its graph, its card and its golden sequences are checked before
it answers anything.

The seal shows that a file is as it was sealed, not who sealed it: it can be made by anyone. So
everything else is checked too, and in this order: seal, bytes (onnx_bytes.py), card, operators,
shapes and trees (onnx_rules.py), all before onnxruntime opens the file; then what it answers on the
golden sequences.
"""

from __future__ import annotations

from pathlib import Path

import onnxruntime as ort

from edge_runtime.answer_ranges import require_in_range
from edge_runtime.errors import NotAModel
from edge_runtime.golden import check_golden, golden_answers, golden_from_json
from edge_runtime.graph import Outputs, open_session
from edge_runtime.memory import give_back
from edge_runtime.model_file import (
    GOLDEN_KEY,
    ModelCard,
    check_runtime,
    read_card,
    read_sealed,
    require_own_seal,
)
from edge_runtime.onnx_bytes import read_onnx
from edge_runtime.onnx_rules import require_ours

LONGEST_REASON = 200
"""Characters of what onnxruntime says, which may be pages."""


class Model:
    """A model file whose seal holds, whose graph and card fit, and whose golden sequences were
    reproduced."""

    def __init__(self, path: str | Path) -> None:
        check_runtime()
        self.path = Path(path)
        data = read_sealed(path)
        self.card, golden = read_model(data, path)
        self.session: ort.InferenceSession = _opened(data, path)
        answers = self._golden_answers()
        require_in_range(answers, self.card, path)
        check_golden(golden, answers, str(path))
        give_back()

    def _golden_answers(self) -> Outputs:
        card = self.card
        try:
            return golden_answers(self.session, card.n_channels, card.unit, card.settle_samples)
        except Exception as error:  # onnxruntime raises several unrelated types of its own
            raise _refusal(
                f"onnxruntime cannot run it ({error!s:.{LONGEST_REASON}})", self.path
            ) from None


def read_model(data: bytes, path: str | Path) -> tuple[ModelCard, Outputs]:
    """Card and golden sequences of a model file's bytes; NotAModel where card and graph are not
    ours."""
    try:
        told = read_onnx(data)
        require_own_seal(data, told.metadata)
    except ValueError as error:
        raise _refusal(str(error), path) from None
    card = read_card(told.metadata, path)
    try:
        require_ours(told, card)
    except ValueError as error:
        raise _refusal(str(error), path) from None
    return card, golden_from_json(told.metadata.get(GOLDEN_KEY, ""), str(path))


def _opened(data: bytes, path: str | Path) -> ort.InferenceSession:
    try:
        return open_session(data)
    except Exception as error:  # onnxruntime raises several unrelated types of its own
        raise _refusal(f"onnxruntime cannot open it ({error!s:.{LONGEST_REASON}})", path) from None


def _refusal(what: str, path: str | Path) -> NotAModel:
    return NotAModel(
        what,
        where=path,
        cause="a file that another program made or altered and sealed again",
        next_step="export the model again with holdfast export",
    )
