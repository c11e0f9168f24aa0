"""For: a model file on whole recordings: events, baselines, states, reports.
May import: training and below.
Begin with: evaluate.py, from a file and sets to figures.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from holdfast.evaluation.model_outputs import run_model as run_model
    from holdfast.evaluation.states import to_frame as to_frame

MOST_FALSE_PER_MIN = 0.5
"""Default: false alarms a minute that are allowed where a confidence is chosen."""
_LATE = {
    "to_frame": "holdfast.evaluation.states",
    "run_model": "holdfast.evaluation.model_outputs",
}
"""Imported when first used, so that `holdfast evaluate --help` loads no pandas."""


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LATE[name]), name)
