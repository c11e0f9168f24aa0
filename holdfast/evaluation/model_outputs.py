"""The outputs of a model file at every sample and at windows, each recording from a fresh state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, Json
from holdfast.core.errors import ChannelError
from holdfast.core.progress import Part, ignored
from holdfast.data.metrics import HeadFigures, report
from holdfast.data.recording import DataSet, Recording
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs, Steps
from holdfast.edge_runtime.model import LABEL, situations_of
from holdfast.edge_runtime.monitor import require_fit
from holdfast.evaluation.alarms import RecordingAnswers
from holdfast.step.heads import riskier_argmax
from holdfast.step.network import IntArray
from holdfast.training.crossval import pick_rows, stepped
from holdfast.training.fitting import fingerprint
from holdfast.training.plan import TASK_HEADS

OUTPUTS = ("votes", "unknown", *LABEL)
NO_CLASS = -1
"""Where no class is known; below every class, as UNKNOWN is below every situation."""


@dataclass(frozen=True)
class ModelOutputs(RecordingAnswers):
    """The outputs of a model file on one recording; its answers are what the decision is made from.

    p_situation [T, 4]. eight [T]: the class with most votes (the riskier on a tie). NO_CLASS where
    the state is unknown, or the model has no weight output.
    """

    p_situation: npt.NDArray[np.float32]
    eight: npt.NDArray[np.int64]


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
    return stepped(steps, recordings, every_row(recordings), part)


def every_row(recordings: Sequence[Recording]) -> list[IntArray]:
    """The rows [T] of all samples of each recording."""
    return [np.arange(len(one.samples)) for one in recordings]


def read_outputs(
    model: OpenedModel, recordings: Sequence[Recording], computed: Sequence[Outputs]
) -> list[ModelOutputs]:
    """The outputs of `everywhere`, read as the monitor on the hand reads them."""
    read = []
    for recording, out in zip(recordings, computed, strict=True):
        votes = out["votes"].astype(np.int64)
        # Where the hand would say unknown, no class may be counted as its answer.
        withheld = out["unknown"]
        situation = situations_of(out, model.card.n_channels // 3)

        # A model of four situations has no votes by weight.
        eight = np.full(len(votes), NO_CLASS)
        if model.card.has_weight:
            eight = np.where(withheld, NO_CLASS, riskier_argmax(votes))
        read.append(
            ModelOutputs(
                recording,
                situation=np.where(withheld, UNKNOWN, situation),
                risky_permille=risky_permille(votes),
                p_situation=out["p_situation"],
                eight=eight,
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


@dataclass(frozen=True)
class WindowFigures:
    """Figures of a model at the windows of a set.

    trained_on_recordings: recordings of the set that the model was trained on. unknown_windows:
    where the state would be unknown; each counts as a miss.
    """

    heads: HeadFigures
    model_id: str
    data: str
    kind: str
    trained_on_recordings: int
    unknown_windows: int
    caveat: str
    seed: int

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        fields = asdict(self)
        del fields["heads"]
        return self.heads.to_json() | fields


def require_model_fits(model: OpenedModel, data: DataSet) -> None:
    """Raise ChannelError, UnitError or RateError where the set does not fit the model."""
    require_fit(
        model.card,
        n_channels=3 * data.n_sensors,
        unit=data.unit,
        rate_hz=data.rate_hz,
        where=data.name,
    )
    hand = model.card.hand
    ours = hand.unmeasured_names if hand else ()
    theirs = data.hand.unmeasured_names if data.hand else ()
    if ours != theirs:
        raise ChannelError(
            f"not measured in the set: {', '.join(theirs) or 'nothing'}; by the model's hand: "
            f"{', '.join(ours) or 'nothing'}",
            where=data.name,
            cause="sensors that measure other axes",
            next_step="holdfast export MODEL --hand CARD --out FILE, with the set's hand.toml",
        )
    if hand is None or data.hand is None:
        return
    if hand.sensor_sides != data.hand.sensor_sides:
        raise ChannelError(
            f"the set is of the hand {data.hand.name}, the model of {hand.name}",
            where=data.name,
            cause="sensors on other sides of the hand",
            next_step="use a model made for this hand, or train one",
        )


def heads_with_task(model: OpenedModel, data: DataSet) -> list[str]:
    """The model's further heads that the set has a task for."""
    heads = [TASK_HEADS[task] for task in data.tasks]
    return [head for head in heads if head in model.card.heads]


def window_figures(
    model: OpenedModel, data: DataSet, computed: Sequence[Outputs], *, seed: int = 0
) -> WindowFigures:
    """Figures of a model at the windows of a set, and how much of the set it was trained on.

    computed: [T, ..] LABEL, "unknown" and `heads_with_task` at every sample of each recording,
    streamed from a fresh state. A window at which the state would be unknown is a miss.
    """
    data = data.with_situations()
    withheld = at_windows(data, "situations", "unknown", computed)
    named = {name: at_windows(data, "situations", name, computed) for name in LABEL}
    answered = situations_of(named, model.card.n_channels // 3)
    # One past the last situation is "unknown", which misses whatever was there.
    situation = np.where(withheld, len(SITUATIONS), answered)

    risky_score = None
    # A head that the set has no labels for cannot be scored.
    if "p_risky_250ms" in heads_with_task(model, data):
        score = at_windows(data, "predict_250ms", "p_risky_250ms", computed)
        unknown = at_windows(data, "predict_250ms", "unknown", computed)
        # Where the hand would say unknown, the further head predicts nothing.
        risky_score = np.where(unknown, 0.0, score.astype(np.float64))

    # By content: a recording that was copied or renamed is still one that it was trained on.
    seen = set(model.card.raw["training"].get("recordings", ()))
    overlap = sum(fingerprint(recording) in seen for recording in data.recordings)
    cannot_tell = model.card.not_learned

    return WindowFigures(
        heads=report(data, situation, risky_score, not_learned=cannot_tell, seed=seed),
        model_id=model.card.model_id,
        data=data.name,
        kind=data.kind,
        trained_on_recordings=overlap,
        unknown_windows=int(withheld.sum()),
        caveat=data.caveat,
        seed=seed,
    )


def at_windows(
    data: DataSet, task: str, output: str, computed: Sequence[Outputs]
) -> npt.NDArray[Any]:
    """[M, ..] an output at the task's windows, out of all samples of each recording."""
    of_output = [one[output] for one in computed]
    return pick_rows(data, task, every_row(data.recordings), of_output)
