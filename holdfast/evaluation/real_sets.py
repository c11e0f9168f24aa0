"""Real recordings: the output of `make real`, scored by the same rules as simulated ones.

The default model runs at another rate than these sets. So the file is one of `make real`, trained
without one fold of people, and it is evaluated on these people only.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from holdfast.core.contract import Json
from holdfast.core.errors import DataNotFound, NotAModel
from holdfast.core.schema import json_of, text_of
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.evaluate import EvaluationRequest, evaluate_events
from holdfast.evaluation.figures import Evaluation
from holdfast.training.datasets import load
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, assign_groups

HUMAN = "human_slip_uskin"
NEXT = (
    "not here: `make real` trains, exports and leaves them (about 6 min), then `make evaluate` "
    "again"
)
NOTE = (
    "as deployed, without a threshold of its own: no people are left to choose one on"
)
FOLD = 0
"""The fold that studies/real/streamed_fold.py exports."""


@dataclass(frozen=True)
class RealSetsMissing:
    """There are no figures of real recordings: how to get them, and why they could not be read."""

    next_step: str = NEXT
    why: str | None = None

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        written = {"next": self.next_step}
        if self.why is not None:
            written["why"] = self.why
        return written


@dataclass(frozen=True)
class RealFigures:
    """Figures of unseen people."""

    human: Evaluation
    people: list[str]
    note: str = NOTE

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        human = self.human.to_json() | {"people": self.people}
        return {HUMAN: human, "note": self.note}


def real_figures(folder: Path, seed: int = 0) -> RealFigures | RealSetsMissing:
    """Figures of the real sets from a folder of `make real`."""
    # Both are needed: the seed of the folds is in the metrics, and the model in the fold.
    metrics = folder / "metrics.json"
    file = folder / "fold" / "holdfast.onnx"
    if not metrics.is_file() or not file.is_file():
        return RealSetsMissing()
    # Files of an older `make real` may lack a figure, and the data set may be gone since.
    try:
        seed_of_folds = int(json_of(text_of(metrics))["seed"])
        data = load(HUMAN)
        model = ModelChoice(str(file))
        # Opened here once, so that a damaged file is reported as missing figures.
        model.open()
    except (OSError, ValueError, KeyError, TypeError, DataNotFound, NotAModel) as error:
        return RealSetsMissing(why=str(error))

    people = held_out_people(data, seed_of_folds)
    request = EvaluationRequest((HUMAN,), people=people, seed=seed)
    # As deployed: no people are left to choose a confidence on.
    human = evaluate_events(model, request)
    return RealFigures(human, sorted(people))


def held_out_people(data: DataSet, seed: int) -> frozenset[str]:
    """The people that the exported fold's forests were not trained on."""
    # The same assignment as in training, which depends on the seed alone.
    folds = assign_groups(data.group_of("situations"), TrainingPlan().folds, seed=seed)
    return frozenset(name for name, fold in folds.items() if fold == FOLD)
