"""What computes a step: onnxruntime (model.py), or the model's compiled C form (c_engine.py)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from holdfast.core.errors import LibraryRefused, ModelError, UsageError
from holdfast.core.schema import LIBRARY, c_folder

if TYPE_CHECKING:
    from holdfast.edge_runtime.graph import Stepper
    from holdfast.edge_runtime.model_file import ModelCard

AUTO: Final = "auto"
ONNXRUNTIME: Final = "onnxruntime"
C: Final = "c"
ENGINES = (AUTO, ONNXRUNTIME, C)


class OpenedModel(Protocol):
    """A model file that has passed all checks, with something that steps it.

    engine: what steps it, as a line for people; "" where nothing else was there.
    """

    engine: str

    @property
    def card(self) -> ModelCard:
        """The card in the file."""
        ...

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> Stepper:
        """The step of B hands, from a fresh state. outputs: those to compute."""
        ...


@dataclass(frozen=True)
class ModelChoice:
    """A model file and what steps it: AUTO takes its C form where one is that fits.

    library: of the C engine; None: in `c_folder`, beside the model.
    """

    path: str
    engine: str = ONNXRUNTIME
    library: str | None = None

    def open(self) -> OpenedModel:
        """The model, checked. Raises a ModelError, or UsageError."""
        if self.library and self.engine == ONNXRUNTIME:
            raise UsageError(
                "--library is for the C engine", next_step="add --engine c"
            )
        if self.library or self.engine == C:
            from holdfast.edge_runtime.c_engine import CompiledModel

            return CompiledModel(self.path, self.library)
        return self._fastest()

    def _fastest(self) -> OpenedModel:
        """Its C form where AUTO finds one that fits, else onnxruntime with the reason."""
        library = c_folder(self.path) / LIBRARY
        why_not = ""
        if self.engine != ONNXRUNTIME and library.is_file():
            try:
                # found by itself: what it does is not known before it runs
                if library.stat().st_uid not in (0, os.getuid()):
                    raise LibraryRefused(
                        "the library belongs to another user",
                        where=library,
                        next_step="name it if you trust it: library = in holdfast.toml",
                    )
                from holdfast.edge_runtime.c_engine import CompiledModel

                return CompiledModel(self.path, library)
            except ModelError as error:
                why_not = f"{error}; until then onnxruntime computes the step"

        from holdfast.edge_runtime.model import Model

        opened = Model(self.path)
        opened.engine = why_not
        return opened
