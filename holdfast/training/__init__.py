"""Recordings -> critical points -> balanced windows -> forest -> artifact.

The centre is four files: datasets/thesis.py reads recordings, critical_points.py looks for the
moments at which a grip changes, windows.py labels windows of the eight classes and balances them,
crossval.py trains the forest and answers for people it never saw. fitting.py joins the four, and
plan.py has what they choose by default.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from holdfast.training.frames import (
        recordings_from_frames as recordings_from_frames,
    )

if __name__ == "training":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)

_LATE = {"recordings_from_frames": "holdfast.training.frames"}
"""Imported when first used, so that `holdfast train --help` loads no pandas."""


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LATE[name]), name)
