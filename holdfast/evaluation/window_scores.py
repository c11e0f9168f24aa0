"""An exported file on a labelled set: the file itself answers, sample by sample, and is scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, FloatArray
from holdfast.core.reading import Json
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs, run_recordings
from holdfast.edge_runtime.monitor import Model, require_fit
from holdfast.training.featurise import pick_rows, rows_wanted
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import fingerprint, with_situations
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


def evaluate(model: Model, data: DataSet, *, seed: int = 0) -> WindowFigures:
    """Figures of a model at the windows of a set, and how much of the set it was trained on.

    Every recording is streamed from a fresh state, as on the hand; a window at which the state
    would be unknown counts as a miss. Raises ChannelError, UnitError or RateError where the set
    does not fit the model.
    """
    require_model_fits(model, data)
    data = with_situations(data)
    answers = stream(
        model, data, ["situation", "unknown", *heads_with_task(model, data)]
    )
    return window_figures(model, data, answers, seed=seed)


def require_model_fits(model: OpenedModel, data: DataSet) -> None:
    """Raise ChannelError, UnitError or RateError where the set does not fit the model."""
    require_fit(
        model.card,
        n_channels=3 * data.n_sensors,
        unit=data.unit,
        rate_hz=data.rate_hz,
        where=data.name,
    )


def heads_with_task(model: OpenedModel, data: DataSet) -> list[str]:
    """The model's further heads that the set has a task for."""
    return [
        TASK_HEADS[task] for task in data.tasks if TASK_HEADS[task] in model.card.heads
    ]


def window_figures(
    model: OpenedModel, data: DataSet, answers: dict[str, Outputs], *, seed: int = 0
) -> WindowFigures:
    """The same from computed answers at the windows of a set with the task "situations"."""
    heads = heads_with_task(model, data)
    withheld = answers["situations"]["unknown"]
    situation = np.where(withheld, len(SITUATIONS), answers["situations"]["situation"])
    seen = set(model.card.raw["training"].get("recordings", ()))
    overlap = sum(fingerprint(recording) in seen for recording in data.recordings)
    return WindowFigures(
        heads=report(data, situation, _risky_score(answers, heads), seed=seed),
        model_id=model.card.model_id,
        data=data.name,
        kind=data.kind,
        trained_on_recordings=overlap,
        unknown_windows=int(withheld.sum()),
        caveat=data.caveat,
        seed=seed,
    )


def _risky_score(answers: dict[str, Outputs], heads: list[str]) -> FloatArray | None:
    """The further head's answer; where the hand would say unknown it predicts nothing."""
    if "p_risky_250ms" not in heads:
        return None
    at_task = answers["predict_250ms"]
    return np.where(
        at_task["unknown"], 0.0, at_task["p_risky_250ms"].astype(np.float64)
    )


def stream(model: Model, data: DataSet, outputs: list[str]) -> dict[str, Outputs]:
    """Task -> output -> [M, ...] at every window of the set."""
    wanted = rows_wanted(data)
    values = [recording.samples for recording in data.recordings]
    valid = [recording.valid for recording in data.recordings]
    return at_windows(
        data, run_recordings(model.session, values, valid, outputs, wanted), wanted
    )


def at_windows(
    data: DataSet, computed: Sequence[Outputs], rows: list[npt.NDArray[np.int64]]
) -> dict[str, Outputs]:
    """The same, out of what was computed at these rows of each recording."""
    return {
        task: {
            name: pick_rows(data, task, rows, [c[name] for c in computed])
            for name in computed[0]
        }
        for task in data.tasks
    }
