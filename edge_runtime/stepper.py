"""The step of many hands, whatever computes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy.typing as npt

from holdfast.edge_runtime.contract import BoolArray, FloatArray


class Stepper(Protocol):
    """The step of B hands. sample [B, C] and valid [B, S] are written into before a step.

    out: arrays [B, ..] by the names of the outputs; the next step reuses them.
    """

    sample: FloatArray
    valid: BoolArray
    out: dict[str, npt.NDArray[Any]]

    def step(self) -> dict[str, npt.NDArray[Any]]:
        """Advance by one sample; returns `out`."""
        ...

    def reset(self) -> None:
        """Start from a fresh state at the next sample."""
        ...


Steps = Callable[[int], Stepper]
"""Number of hands B -> their step, from a fresh state, with the outputs that its maker chose."""
