"""What computes a step: onnxruntime (model.py), or the model's compiled C form (c_engine.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from holdfast.core.errors import UsageError

if TYPE_CHECKING:
    from holdfast.edge_runtime.graph import Stepper
    from holdfast.edge_runtime.model_file import ModelCard

ONNXRUNTIME = "onnxruntime"
C = "c"
ENGINES = (ONNXRUNTIME, C)


class OpenedModel(Protocol):
    """A model file that has passed all checks, with something that steps it."""

    @property
    def card(self) -> ModelCard:
        """The card in the file."""
        ...

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> Stepper:
        """The step of B hands, from a fresh state. outputs: those to compute."""
        ...


@dataclass(frozen=True)
class ModelChoice:
    """A model file and what steps it. library: of the C engine; None: in MODEL-c next to it."""

    path: str
    engine: str = ONNXRUNTIME
    library: str | None = None

    def open(self) -> OpenedModel:
        """The model, checked. Raises a ModelError, or UsageError."""
        if self.engine == C:
            from holdfast.edge_runtime.c_engine import CompiledModel

            return CompiledModel(self.path, self.library)

        if self.library:
            raise UsageError(
                "--library is for the C engine", next_step="add --engine c"
            )

        from holdfast.edge_runtime.model import Model

        return Model(self.path)
