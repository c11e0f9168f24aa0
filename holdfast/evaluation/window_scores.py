"""Scores of a model file at the windows of a labelled set. Intervals are 95 %, over its groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, Json, untold_of
from holdfast.core.errors import ChannelError
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.monitor import require_fit
from holdfast.training.featurise import pick_rows
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import fingerprint
from holdfast.training.metrics import report
from holdfast.training.plan import TASK_HEADS
from holdfast.training.recording import DataSet


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

    computed: [T, ..] "situation", "unknown" and `heads_with_task` at every sample of each
    recording, streamed from a fresh state. A window at which the state would be unknown is a miss.
    """
    data = data.with_situations()
    withheld = at_windows(data, "situations", "unknown", computed)
    answered = at_windows(data, "situations", "situation", computed)
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
    cannot_tell = untold_of(model.card.raw)

    return WindowFigures(
        heads=report(data, situation, risky_score, untold=cannot_tell, seed=seed),
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
    every_row = [np.arange(len(one.samples)) for one in data.recordings]
    return pick_rows(data, task, every_row, [one[output] for one in computed])
