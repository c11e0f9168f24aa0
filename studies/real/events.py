"""Events of real recordings: the file of `make real`, scored by the same rules as simulated sets.

The default model runs at another rate than these sets. So the file is one of `make real`, trained
without one fold of people, and it is evaluated on these people only, as deployed: no people are
left to choose a confidence on.
"""

from __future__ import annotations

import json
from pathlib import Path

from holdfast.core.errors import DataNotFound
from holdfast.core.trial_layout import read_json
from holdfast.core.writing import write_whole
from holdfast.data.datasets import load
from holdfast.data.recording import DataSet, assign_groups
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.evaluate import EvaluationRequest, evaluate_events
from holdfast.evaluation.report import write_event_report
from holdfast.training.plan import TrainingPlan
from studies.real.methods import HUMAN
from studies.real.streamed_fold import FOLD


def write_real_events(folder: Path, out: Path, seed: int) -> list[Path]:
    """Evaluate the fold in a folder of `make real`; writes real.json and real.html.

    Raises DataNotFound where the fold or the data set is not there.
    """
    # Both are needed: the seed of the folds is in the metrics, and the model in the fold.
    metrics = folder / "metrics.json"
    file = folder / "fold" / "holdfast.onnx"
    if not metrics.is_file() or not file.is_file():
        raise DataNotFound(
            "no fold of make real", where=folder, next_step="make real (about 6 min)"
        )
    people = held_out_people(load(HUMAN), int(read_json(metrics)["seed"]))
    request = EvaluationRequest((HUMAN,), people=people, seed=seed)
    found = evaluate_events(ModelChoice(str(file)), request)
    figures = found.to_json() | {"people": sorted(people)}
    text = json.dumps(figures, indent=1, allow_nan=False) + "\n"
    page = write_event_report(out / "real.html", found)
    return [write_whole(out / "real.json", text), page]


def held_out_people(data: DataSet, seed: int) -> frozenset[str]:
    """The people that the exported fold's forests were not trained on."""
    # The same assignment as in training, which depends on the seed alone.
    folds = assign_groups(data.group_of("situations"), TrainingPlan().folds, seed=seed)
    return frozenset(name for name, fold in folds.items() if fold == FOLD)
