"""Real recordings beside the simulated ones: the output of `make real`, scored by the same rules.

The default model runs at another rate than these sets. So the file is one of `make real`, trained
without one fold of people, and it is evaluated on these people only.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from holdfast.edge_runtime.engine import ModelChoice
from holdfast.edge_runtime.errors import DataNotFound, NotAModel
from holdfast.edge_runtime.reading import Json, json_of, text_of
from holdfast.evaluation.eflesh_figures import EfleshFigures
from holdfast.evaluation.evaluate import evaluate_events
from holdfast.evaluation.evaluation_figures import Evaluation
from holdfast.evaluation.request import EvaluationRequest
from holdfast.training.datasets import load
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet
from holdfast.training.splits import assign_groups

HUMAN, EFLESH = "human_slip_uskin", "eflesh_slip"
NEXT = (
    "not here: `make real` trains, exports and leaves them (about 6 min), then `make evaluate` "
    "again"
)
NOTE = "as deployed, without a threshold of its own: no people are left to choose one on"
FOLD = 0
"""The fold that studies/real/streamed_fold.py exports."""


@dataclass(frozen=True)
class RealSetsMissing:
    """There are no figures of real recordings: how to get them, and why they could not be read."""

    next_step: str = NEXT
    why: str | None = None

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        return {"next": self.next_step} | ({"why": self.why} if self.why is not None else {})


@dataclass(frozen=True)
class RealFigures:
    """Figures of unseen people, and what `make real` wrote of eflesh_slip, if it did."""

    human: Evaluation
    people: list[str]
    eflesh: EfleshFigures | None
    note: str = NOTE

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        human = self.human.to_json() | {"people": self.people}
        eflesh = None if self.eflesh is None else asdict(self.eflesh)
        return {HUMAN: human, EFLESH: eflesh, "note": self.note}


def real_figures(folder: Path, seed: int = 0) -> RealFigures | RealSetsMissing:
    """Figures of the real sets from a folder of `make real`."""
    metrics, file = folder / "metrics.json", folder / "fold" / "holdfast.onnx"
    if not metrics.is_file() or not file.is_file():
        return RealSetsMissing()
    try:
        written = json_of(text_of(metrics))
        eflesh = EfleshFigures.from_json(written[EFLESH]) if EFLESH in written else None
        data, model = load(HUMAN), ModelChoice(str(file))
        model.open()
    except (OSError, ValueError, KeyError, TypeError, DataNotFound, NotAModel) as error:
        return RealSetsMissing(why=str(error))
    people = held_out_people(data, int(written["seed"]))
    human = evaluate_events(model, EvaluationRequest((HUMAN,), people=people, seed=seed))
    return RealFigures(human, sorted(people), eflesh)


def held_out_people(data: DataSet, seed: int) -> frozenset[str]:
    """The people that the exported fold's forests were not trained on."""
    folds = assign_groups(data.group_of("situations"), TrainingPlan().folds, seed=seed)
    return frozenset(name for name, fold in folds.items() if fold == FOLD)
