"""Scores at the windows of a labelled set: of a model file, and of votes for the eight classes.

"Nothing, light" and "nothing, heavy" are the same signal. So the accuracy over eight balanced
classes is at most 6/8 + 2/8 x 1/2 = 0.875; a higher one shows that the label leaked. "Seven" counts
nothing once, with the votes of both added. Intervals are 95 %, over trials, unless stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    CLASSES,
    SITUATIONS,
    Json,
    untold_of,
)
from holdfast.core.errors import ChannelError
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs, run_recordings
from holdfast.edge_runtime.monitor import Model, require_fit
from holdfast.export.heads import riskier_argmax, situation_votes
from holdfast.export.network import IntArray
from holdfast.training.featurise import pick_rows, rows_wanted
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import fingerprint
from holdfast.training.metrics import Labels, report
from holdfast.training.plan import TASK_HEADS
from holdfast.training.recording import DataSet

LEVELS = {"eight": CLASSES, "seven": ("nothing", *CLASSES[2:]), "four": SITUATIONS}


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


def evaluate(model: Model, data: DataSet, *, seed: int = 0) -> WindowFigures:
    """Figures of a model at the windows of a set, and how much of the set it was trained on.

    Every recording is streamed from a fresh state, as on the hand; a window at which the state
    would be unknown counts as a miss. Raises ChannelError, UnitError or RateError where the set
    does not fit the model.
    """
    require_model_fits(model, data)
    data = data.with_situations()
    # `unknown` is read with every head: a withheld answer must count as a miss.
    outputs = ["situation", "unknown", *heads_with_task(model, data)]
    return window_figures(model, data, stream(model, data, outputs), seed=seed)


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
    model: OpenedModel, data: DataSet, answers: dict[str, Outputs], *, seed: int = 0
) -> WindowFigures:
    """The same from computed answers at the windows of a set with the task "situations"."""
    at_windows = answers["situations"]
    withheld = at_windows["unknown"]

    # One past the last situation is "unknown", which misses whatever was there.
    situation = np.where(withheld, len(SITUATIONS), at_windows["situation"])

    risky_score = None
    # A head that the set has no labels for cannot be scored.
    if "p_risky_250ms" in heads_with_task(model, data):
        at_task = answers["predict_250ms"]
        score = at_task["p_risky_250ms"].astype(np.float64)
        # Where the hand would say unknown, the further head predicts nothing.
        risky_score = np.where(at_task["unknown"], 0.0, score)

    # By content: a recording that was copied or renamed is still one that it was trained on.
    seen = set(model.card.raw["training"].get("recordings", ()))
    overlap = sum(fingerprint(recording) in seen for recording in data.recordings)

    return WindowFigures(
        heads=report(
            data,
            situation,
            risky_score,
            untold=untold_of(model.card.raw),
            seed=seed,
        ),
        model_id=model.card.model_id,
        data=data.name,
        kind=data.kind,
        trained_on_recordings=overlap,
        unknown_windows=int(withheld.sum()),
        caveat=data.caveat,
        seed=seed,
    )


def stream(model: Model, data: DataSet, outputs: list[str]) -> dict[str, Outputs]:
    """Task -> output -> [M, ...] at every window of the set."""
    wanted = rows_wanted(data)
    # Streamed whole, as on the hand: a window alone would have no state.
    values = [recording.samples for recording in data.recordings]
    valid = [recording.valid for recording in data.recordings]
    # Only the wanted rows are kept; the graph still steps every sample, for its state.
    computed = run_recordings(model.session, values, valid, outputs, wanted)
    return at_windows(data, computed, wanted)


def at_windows(
    data: DataSet, computed: Sequence[Outputs], rows: list[npt.NDArray[np.int64]]
) -> dict[str, Outputs]:
    """The same, out of what was computed at these rows of each recording."""
    answers: dict[str, Outputs] = {}
    for task in data.tasks:
        picked = {}
        for name in computed[0]:
            of_each = [outputs[name] for outputs in computed]
            picked[name] = pick_rows(data, task, rows, of_each)
        answers[task] = picked

    return answers


def labels_at(label: Labels, level: str) -> IntArray:
    """Labels 0..7 at a level: seven (0 and 1 are one) or four (light and heavy are one).

    >>> labels_at(np.arange(8), "seven").tolist(), labels_at(np.arange(8), "four").tolist()
    ([0, 0, 1, 2, 3, 4, 5, 6], [0, 0, 1, 1, 2, 2, 3, 3])
    """
    if level == "seven":
        # Both kinds of nothing become 0, and all other classes move down by one.
        label = np.maximum(label - 1, 0)
    if level == "four":
        label = label // 2
    return np.asarray(label, dtype=np.int64)


def answers_at(votes: IntArray, level: str) -> IntArray:
    """[M, 8] votes -> [M] answers at a level; votes of merged classes are added."""
    if level == "four":
        return riskier_argmax(situation_votes(votes))
    if level == "seven":
        # Light and heavy nothing first: together they may win over a class that beats each.
        nothing = votes[:, :2].sum(axis=1)
        votes = np.column_stack([nothing, votes[:, 2:]])
    return riskier_argmax(votes)
