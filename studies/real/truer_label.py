"""human_slip_uskin by rotation in the hand: `python -m holdfast.studies.real.truer_label OUT`.

The set's usual label is the object's rotation, about half of it the wrist's. With the hand's IMU
the wrist cancels. The same people, folds, features and baselines; only what is called a slip
differs.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from holdfast.edge_runtime.reading import Json
from holdfast.edge_runtime.writing import write_whole
from holdfast.studies.real import baselines
from holdfast.studies.row_names import CLOCK, OURS_18
from holdfast.training.crossval import cross_validate
from holdfast.training.datasets import find, human_slip_uskin
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import held_out_figures
from holdfast.training.plan import TrainingPlan
from holdfast.training.progress import stages
from holdfast.training.recording import DataSet
from holdfast.training.say import Say


@dataclass(frozen=True)
class TruerLabel:
    """Figures by stored name of the method. windows: how many of each situation."""

    kind: str
    windows: dict[str, int]
    rows: dict[str, HeadFigures]

    def to_json(self) -> Json:
        """truer.json."""
        rows = {name: row.to_json() for name, row in self.rows.items()}
        return {"kind": self.kind, "windows": self.windows, "rows": rows}


def truer_label(root: Path, seed: int, say: Say) -> TruerLabel:
    """Rows as in `make real`: ours, the raw forest and the clock. root: the set's folder."""
    data, everything = (
        human_slip_uskin.load(root, channels=channels, in_hand=True) for channels in (18, 48)
    )
    plan = TrainingPlan()
    say("ours")
    features = features_of(data, spec_for(data, plan.groups))
    rows = {OURS_18: held_out_figures(data, cross_validate(data, features, plan, seed=seed), seed)}
    say("raw forest")
    rows["raw forest, 18 channels"] = baselines.raw_forest(data, seed=seed)
    say("timing-only baseline")
    rows[CLOCK] = baselines.clock(everything, seed=seed)
    return TruerLabel(data.kind, _counts(data), rows)


def _counts(data: DataSet) -> dict[str, int]:
    task = data.tasks["situations"]
    return {name: int((task.label == label).sum()) for label, name in enumerate(task.classes)}


if __name__ == "__main__":
    with stages(3) as progress:
        figures = truer_label(find("human_slip_uskin"), 0, progress)
    write_whole(Path(sys.argv[1]), json.dumps(figures.to_json(), indent=1, allow_nan=False) + "\n")
