"""The outputs of a model file at every sample of a set, each recording from a fresh state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, BoolArray
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs, Steps
from holdfast.evaluation.alarms import Answers
from holdfast.evaluation.window_scores import require_model_fits
from holdfast.export.heads import riskier_argmax
from holdfast.export.network import IntArray
from holdfast.training.featurise import stepped
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet, Recording

OUTPUTS = ("situation", "votes", "unknown", "detectors", "p_situation")
NO_CLASS = -1
"""Where no class is known; below every class, as UNKNOWN is below every situation."""


@dataclass(frozen=True)
class ModelOutputs:
    """The outputs of a model file on one recording.

    situation [T]: UNKNOWN or 0..3. risky_permille [T]: of the votes. p_situation [T, 4]. detectors
    [T, D]. eight [T]: the class with most votes (the riskier on a tie). NO_CLASS where the state is
    unknown, or the model has no weight output.
    """

    recording: Recording
    situation: npt.NDArray[np.int64]
    risky_permille: npt.NDArray[np.int64]
    p_situation: npt.NDArray[np.float32]
    eight: npt.NDArray[np.int64]
    detectors: BoolArray

    @property
    def answers(self) -> Answers:
        """What the decision is made from."""
        return Answers(self.recording, self.situation, self.risky_permille)


def run_model(model: OpenedModel, data: DataSet) -> list[ModelOutputs]:
    """The outputs of a model file on a set, each recording from a fresh state.

    Raises ChannelError, UnitError or RateError where the set does not fit the model.
    """
    require_model_fits(model, data)
    # From a fresh state each: no recording may see the one before it.
    computed = everywhere(steps_with(model, OUTPUTS), data.recordings)
    return read_outputs(model, data.recordings, computed)


def steps_with(model: OpenedModel, outputs: Sequence[str]) -> Steps:
    """The step of any number of hands by the model's engine. outputs: those to compute."""
    return lambda hands: model.stepper(outputs, hands)


def everywhere(
    steps: Steps, recordings: Sequence[Recording], part: Part = ignored
) -> list[Outputs]:
    """Outputs [T, ..] of a step at every sample of every recording, in their order."""
    # Not only at windows: alarms begin at any sample.
    every_row = [np.arange(len(one.samples)) for one in recordings]
    return stepped(steps, recordings, every_row, part)


def read_outputs(
    model: OpenedModel, recordings: Sequence[Recording], computed: Sequence[Outputs]
) -> list[ModelOutputs]:
    """The outputs of `everywhere`, read as the monitor on the hand reads them."""
    read = []
    for recording, out in zip(recordings, computed, strict=True):
        votes = out["votes"].astype(np.int64)
        # Where the hand would say unknown, no class may be counted as its answer.
        withheld = out["unknown"]

        # A model of four situations has no votes by weight.
        eight = np.full(len(votes), NO_CLASS)
        if model.card.has_weight:
            eight = np.where(withheld, NO_CLASS, riskier_argmax(votes))
        read.append(
            ModelOutputs(
                recording,
                situation=np.where(withheld, UNKNOWN, out["situation"]),
                risky_permille=risky_permille(votes),
                p_situation=out["p_situation"],
                eight=eight,
                detectors=out["detectors"],
            )
        )

    return read


def risky_permille(votes: IntArray) -> npt.NDArray[np.int64]:
    """[T, K] votes for four or eight classes -> [T] thousandths of them for a risky slip."""
    # The classes of a risky slip are the last quarter of them.
    first_risky = votes.shape[1] * RISKY_SLIP // 4
    risky = votes[:, first_risky:].sum(axis=1)
    total = votes.sum(axis=1)
    # Whole thousandths, rounded down, as the decision on the hand compares them.
    permille: npt.NDArray[np.int64] = 1000 * risky // total
    return permille
