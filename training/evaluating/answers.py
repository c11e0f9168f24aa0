"""Everything a model file says on a set, at every sample of every recording from a fresh state, as on the hand."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from edge_runtime.contract import CLASSES, RISKY_SLIP, BoolArray
from edge_runtime.decision import UNKNOWN, DecisionRules
from edge_runtime.graph import BATCH, Outputs, run_recordings
from edge_runtime.model_file import ModelCard
from edge_runtime.monitor import Model
from training.alarms import Answers
from training.recording import Recording

OUTPUTS = ("situation", "votes", "unknown", "detectors", "p_situation")
THREADS = 2
"""The step leaves the interpreter alone while it runs; which recordings run together changes no bit."""
NO_CLASS = -1


@dataclass(frozen=True)
class Said:
    """One recording as the file answered it.

    situation [T]: UNKNOWN or 0..3. risky_permille [T]: of the votes. p_situation [T, 4]. detectors [T, D].
    told_class [T]: 0..7 by most votes, the riskier on a tie; NO_CLASS where unknown or where the model knows no weight.
    """

    recording: Recording
    situation: npt.NDArray[np.int64]
    risky_permille: npt.NDArray[np.int64]
    p_situation: npt.NDArray[np.float32]
    told_class: npt.NDArray[np.int64]
    detectors: BoolArray

    @property
    def answers(self) -> Answers:
        """What the decision is made from."""
        return Answers(self.recording, self.situation, self.risky_permille)


def rules_of(card: ModelCard) -> DecisionRules:
    """The decision's rules, as they are deployed."""
    return DecisionRules(**card.decision)


def everywhere(session: ort.InferenceSession, recordings: Sequence[Recording], outputs: Sequence[str]) -> list[Outputs]:
    """Outputs [T, ..] of a step graph on every recording, in their order."""
    order = sorted(range(len(recordings)), key=lambda k: len(recordings[k].samples))
    batches = [order[start : start + BATCH] for start in range(0, len(order), BATCH)]

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


def said(model: Model, recordings: Sequence[Recording], told: Sequence[Outputs]) -> list[Said]:
    """The outputs of `everywhere`, read as the monitor on the hand reads them."""
    return [_said(one, out, knows_weight=model.card.has_weight) for one, out in zip(recordings, told, strict=True)]


def _said(recording: Recording, out: Outputs, *, knows_weight: bool) -> Said:
    votes = out["votes"].astype(np.int64)
    n_classes, withheld = votes.shape[1], out["unknown"]
    last_of_most = n_classes - 1 - np.argmax(votes[:, ::-1], axis=1)
    return Said(
        recording,
        np.where(withheld, UNKNOWN, out["situation"]),
        1000 * votes[:, n_classes * RISKY_SLIP // 4 :].sum(axis=1) // votes.sum(axis=1),
        out["p_situation"],
        np.where(withheld | (not knows_weight), NO_CLASS, last_of_most % len(CLASSES)),
        out["detectors"],
    )
