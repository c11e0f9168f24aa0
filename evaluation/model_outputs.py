"""Everything a model file says on a set, at every sample of every recording from a fresh state, as on the hand."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from edge_runtime.contract import RISKY_SLIP, BoolArray
from edge_runtime.decision import UNKNOWN, DecisionRules
from edge_runtime.graph import BATCH, Outputs, run_recordings
from edge_runtime.model_file import ModelCard
from edge_runtime.monitor import Model
from evaluation.alarms import Answers
from evaluation.scores import answers_at
from export.reference import IntArray
from training.recording import Recording

OUTPUTS = ("situation", "votes", "unknown", "detectors", "p_situation")
THREADS = 2
"""The step leaves the interpreter alone while it runs; which recordings run together changes no bit."""
NO_CLASS = -1


@dataclass(frozen=True)
class ModelOutputs:
    """One recording as the file answered it.

    situation [T]: UNKNOWN or 0..3. risky_permille [T]: of the votes. p_situation [T, 4]. detectors [T, D].
    eight, seven [T]: the class by most votes, the riskier on a tie, of eight and with nothing as one; NO_CLASS where
    unknown, or where the model knows no weight.
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


def everywhere(session: ort.InferenceSession, recordings: Sequence[Recording], outputs: Sequence[str]) -> list[Outputs]:
    """Outputs [T, ..] of a step graph on every recording, in their order."""
    order = sorted(range(len(recordings)), key=lambda k: len(recordings[k].samples))
    size = max(1, min(BATCH, -(-len(order) // THREADS)))
    batches = [order[start : start + size] for start in range(0, len(order), size)]

    def run(batch: list[int]) -> list[Outputs]:
        chosen = [recordings[k] for k in batch]
        rows = [np.arange(len(one.samples)) for one in chosen]
        return run_recordings(session, [o.samples for o in chosen], [o.valid for o in chosen], outputs, rows)

    found: list[Outputs] = [{} for _ in recordings]
    with ThreadPoolExecutor(THREADS) as pool:
        for batch, told in zip(batches, pool.map(run, batches), strict=True):
            for k, one in zip(batch, told, strict=True):
                found[k] = one
    return found


def said(model: Model, recordings: Sequence[Recording], told: Sequence[Outputs]) -> list[ModelOutputs]:
    """The outputs of `everywhere`, read as the monitor on the hand reads them."""
    return [_said(one, out, knows_weight=model.card.has_weight) for one, out in zip(recordings, told, strict=True)]


def _said(recording: Recording, out: Outputs, *, knows_weight: bool) -> ModelOutputs:
    votes, withheld = out["votes"].astype(np.int64), out["unknown"]
    eight = seven = np.full(len(votes), NO_CLASS)
    if knows_weight:
        eight, seven = (np.where(withheld, NO_CLASS, answers_at(votes, level)) for level in ("eight", "seven"))
    situation = np.where(withheld, UNKNOWN, out["situation"])
    return ModelOutputs(recording, situation, risky_permille(votes), out["p_situation"], eight, seven, out["detectors"])


def risky_permille(votes: IntArray) -> npt.NDArray[np.int64]:
    """[T, K] votes for four or eight classes -> [T] thousandths of them for a risky slip, as the monitor counts."""
    risky: npt.NDArray[np.int64] = 1000 * votes[:, votes.shape[1] * RISKY_SLIP // 4 :].sum(axis=1) // votes.sum(axis=1)
    return risky
