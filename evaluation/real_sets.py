"""Real recordings beside the simulated ones: what `make real` left, asked again by the same rules.

The default model runs at another rate than these sets, so the file is the one of `make real` that
left one fold of people out, and it is asked about those people only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from edge_runtime.errors import DataNotFound, NotAModel
from edge_runtime.monitor import Model
from edge_runtime.reading import json_of, text_of
from evaluation.evaluate import EvaluationRequest, evaluate_events
from training.datasets import load
from training.plan import TrainingPlan
from training.recording import DataSet
from training.splits import assign_groups

HUMAN, EFLESH = "human_slip_uskin", "eflesh_slip"
NEXT = "not here: `make real` trains, exports and leaves them (about 12 min), then `make evaluate` again"
FOLD = 0
"""The fold that studies/real/streamed_fold.py exports."""


def real_figures(folder: Path, seed: int = 0) -> dict[str, Any]:
    """Event figures of people never met, and the figures of eflesh_slip; or `next`, how to get
    them."""
    metrics, file = folder / "metrics.json", folder / "fold" / "holdfast.onnx"
    if not metrics.is_file() or not file.is_file():
        return {"next": NEXT}
    try:
        told = json_of(text_of(metrics))
        data, model = load(HUMAN), Model(file)
    except (OSError, ValueError, DataNotFound, NotAModel) as error:
        return {"next": NEXT, "why": str(error)}
    people = held_out_people(data, int(told["seed"]))
    figures = evaluate_events(model, EvaluationRequest((HUMAN,), people=people, seed=seed)).figures
    return {
        HUMAN: figures | {"people": sorted(people)},
        EFLESH: told.get(EFLESH),
        "note": "as deployed, without a threshold of its own: nobody is left to choose one on",
    }


def held_out_people(data: DataSet, seed: int) -> frozenset[str]:
    """Those that the exported fold's forests never met."""
    folds = assign_groups(data.group_of("situations"), TrainingPlan().folds, seed=seed)
    return frozenset(name for name, fold in folds.items() if fold == FOLD)
