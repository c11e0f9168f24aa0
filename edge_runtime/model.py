"""A model file, opened: its seal, its card and its golden sequences are checked before it answers anything."""

from __future__ import annotations

from pathlib import Path

import onnxruntime as ort

from edge_runtime.errors import BrokenSeal, NotAModel
from edge_runtime.golden import check_golden, golden_answers, golden_from_json
from edge_runtime.graph import open_session
from edge_runtime.memory import give_back
from edge_runtime.model_file import GOLDEN_KEY, ModelCard, check_runtime, read_card, read_sealed

ANSWERS = ("votes", "situation", "p_situation", "detectors", "settled", "unknown", "usable_sensors")
WEIGHS = ("p_class", "weight")
"""Outputs that are taken from a graph: always, and where it knows light and heavy."""


class Model:
    """A model file whose seal holds, whose card is readable and whose golden sequences were reproduced."""

    def __init__(self, path: str | Path) -> None:
        check_runtime()
        self.path = Path(path)
        data = read_sealed(path)
        try:
            self.session: ort.InferenceSession = open_session(data)
        except Exception as error:  # onnxruntime raises several unrelated types of its own
            raise BrokenSeal(f"onnxruntime cannot open it ({error})", where=path) from None
        metadata = self.session.get_modelmeta().custom_metadata_map
        self.card: ModelCard = read_card(metadata, path)
        _require_matching_io(self.session, self.card, path)
        self._replay_golden(metadata.get(GOLDEN_KEY, ""))
        give_back()

    def _replay_golden(self, stored: str) -> None:
        card = self.card
        answers = golden_answers(self.session, card.n_channels, card.unit, card.settle_samples)
        check_golden(golden_from_json(stored, str(self.path)), answers, str(self.path))


def _require_matching_io(session: ort.InferenceSession, card: ModelCard, path: str | Path) -> None:
    """Raise NotAModel where the graph is not the one its card speaks of."""
    inputs = {one.name: one.shape for one in session.get_inputs()}
    outputs = {one.name: one.shape for one in session.get_outputs()}
    channels = {"sample": card.n_channels, "valid": card.n_channels // 3}
    named = {*ANSWERS, *card.heads, *(WEIGHS if card.has_weight else ())}
    fits = {name: inputs.get(name, [None])[-1] for name in channels} == channels and named <= set(outputs)
    if not fits or {*inputs} != {*channels, "reset", "state"} or outputs["detectors"][-1] != len(card.detectors):
        raise NotAModel(
            "its graph has not the inputs and outputs that its card names", where=path,
            cause="a card of another model", next_step="export the model again",
        )  # fmt: skip
