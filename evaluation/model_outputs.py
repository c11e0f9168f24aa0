"""Everything a model file says on a set, at every sample of every recording from a fresh state, as
on the hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from edge_runtime.contract import RISKY_SLIP, BoolArray
from edge_runtime.decision import UNKNOWN, DecisionRules
from edge_runtime.graph import Outputs
from edge_runtime.model_file import ModelCard
from edge_runtime.monitor import Model
from evaluation.alarms import Answers
from evaluation.scores import answers_at
from export.reference import IntArray
from training.recording import Recording
from training.say import Part, ignored
from training.stepping import stepped

OUTPUTS = ("situation", "votes", "unknown", "detectors", "p_situation")
NO_CLASS = -1


@dataclass(frozen=True)
class ModelOutputs:
    """One recording as the file answered it.

    situation [T]: UNKNOWN or 0..3. risky_permille [T]: of the votes. p_situation [T, 4]. detectors
    [T, D]. eight, seven [T]: the class by most votes, the riskier on a tie, of eight and with
    nothing as one; NO_CLASS where unknown, or where the model knows no weight.
    """

    recording: Recording
    situation: npt.NDArray[np.int64]
    risky_permille: npt.NDArray[np.int64]
    p_situation: npt.NDArray[np.float32]
    eight: npt.NDArray[np.int64]
    seven: npt.NDArray[np.int64]
    detectors: BoolArray

    @property
    def answers(self) -> Answers:
        """What the decision is made from."""
        return Answers(self.recording, self.situation, self.risky_permille)


def rules_of(card: ModelCard) -> DecisionRules:
    """The decision's rules, as they are deployed."""
    return card.decision


def everywhere(
    session: ort.InferenceSession,
    recordings: Sequence[Recording],
    outputs: Sequence[str],
    part: Part = ignored,
) -> list[Outputs]:
    """Outputs [T, ..] of a step graph at every sample of every recording, in their order."""
    return stepped(
        session, recordings, outputs, [np.arange(len(one.samples)) for one in recordings], part
    )


def said(
    model: Model, recordings: Sequence[Recording], told: Sequence[Outputs]
) -> list[ModelOutputs]:
    """The outputs of `everywhere`, read as the monitor on the hand reads them."""
    return [
        _said(one, out, knows_weight=model.card.has_weight)
        for one, out in zip(recordings, told, strict=True)
    ]


def _said(recording: Recording, out: Outputs, *, knows_weight: bool) -> ModelOutputs:
    votes, withheld = out["votes"].astype(np.int64), out["unknown"]
    eight = seven = np.full(len(votes), NO_CLASS)
    if knows_weight:
        eight, seven = (
            np.where(withheld, NO_CLASS, answers_at(votes, level)) for level in ("eight", "seven")
        )
    situation = np.where(withheld, UNKNOWN, out["situation"])
    return ModelOutputs(
        recording,
        situation,
        risky_permille(votes),
        out["p_situation"],
        eight,
        seven,
        out["detectors"],
    )


def risky_permille(votes: IntArray) -> npt.NDArray[np.int64]:
    """[T, K] votes for four or eight classes -> [T] thousandths of them for a risky slip, as the
    monitor counts."""
    risky: npt.NDArray[np.int64] = (
        1000 * votes[:, votes.shape[1] * RISKY_SLIP // 4 :].sum(axis=1) // votes.sum(axis=1)
    )
    return risky
