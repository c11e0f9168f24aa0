"""A model file, opened: seal, graph, card and golden sequences are checked before it answers.

The seal shows that a file is as it was sealed, not who sealed it: anyone can make one. So
everything else is checked too, in this order: seal, bytes (onnx_bytes.py), card, operators, shapes
and trees (onnx_rules.py), all before onnxruntime opens the file; then its answers on the golden
sequences.

Memory given back to the board once a model is loaded.

Golden sequences: answers stored in a model file, recomputed every time the file is loaded.

The input is made by an integer formula, so that it is the same to the last bit on every machine and
never comes from a recording: a pressed, shaken hand with lost, non-finite and out-of-range samples,
from a zero state. Labels and flags must be equal; float64 within 1e-9, float32 within 1e-6
relative.
"""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.core.errors import NotAModel
from holdfast.edge_runtime.answer_ranges import require_in_range
from holdfast.edge_runtime.golden import check_golden, golden_answers, golden_from_json
from holdfast.edge_runtime.graph import Outputs, StepGraph, open_session
from holdfast.edge_runtime.model_file import (
    GOLDEN_KEY,
    ModelCard,
    check_runtime,
    read_card,
    read_sealed,
    require_own_seal,
)
from holdfast.edge_runtime.onnx_bytes import read_onnx
from holdfast.edge_runtime.onnx_rules import require_ours

if TYPE_CHECKING:
    import onnxruntime as ort

    from holdfast.edge_runtime.model_file import ModelCard


def give_back() -> None:
    """Return freed memory to the system, where libc can: the default model's 114 MB become 82.

    onnxruntime takes a forest apart node by node, and glibc keeps the freed pieces.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


LONGEST_REASON = 200
"""Characters of onnxruntime's message, which may be several pages long."""


class Model:
    """A model file that has passed all checks: seal, graph, card and golden sequences."""

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

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> StepGraph:
        """The step of B hands, from a fresh state. outputs: those to compute."""
        return StepGraph(self.session, hands, outputs)

    def _golden_answers(self) -> Outputs:
        card = self.card
        try:
            return golden_answers(
                self.session, card.n_channels, card.unit, card.settle_samples
            )
        except (
            Exception
        ) as error:  # onnxruntime raises several unrelated types of its own
            raise _refusal(
                f"onnxruntime cannot run it ({error!s:.{LONGEST_REASON}})", self.path
            ) from None


def read_model(data: bytes, path: str | Path) -> tuple[ModelCard, Outputs]:
    """Card and golden sequences of a model file's bytes. Raises NotAModel."""
    try:
        onnx = read_onnx(data)
        require_own_seal(data, onnx.metadata)
    except ValueError as error:
        raise _refusal(str(error), path) from None
    card = read_card(onnx.metadata, path)
    try:
        require_ours(onnx, card)
    except ValueError as error:
        raise _refusal(str(error), path) from None
    return card, golden_from_json(onnx.metadata.get(GOLDEN_KEY, ""), str(path))


def _opened(data: bytes, path: str | Path) -> ort.InferenceSession:
    try:
        return open_session(data)
    except Exception as error:  # onnxruntime raises several unrelated types of its own
        raise _refusal(
            f"onnxruntime cannot open it ({error!s:.{LONGEST_REASON}})", path
        ) from None


def _refusal(what: str, path: str | Path) -> NotAModel:
    return NotAModel(
        what,
        where=path,
        cause="another program made the file, or altered and sealed it again",
        next_step="export the model again with holdfast export",
    )
