"""What computes a step: onnxruntime (model.py), or the model's compiled C form (c_engine.py)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy.typing as npt

from edge_runtime.contract import BoolArray, FloatArray
from edge_runtime.model_file import ModelCard


class Stepper(Protocol):
    """The step of one hand. sample [1, C] and valid [1, S] are written into before a step.

    out: arrays [1, ..] by the names of the outputs; the next step reuses them.
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


class OpenedModel(Protocol):
    """A model file that has passed all checks, with something that steps it."""

    @property
    def card(self) -> ModelCard:
        """The card in the file."""
        ...

    def stepper(self, outputs: Sequence[str]) -> Stepper:
        """One hand's step, from a fresh state. outputs: those to compute."""
        ...
