"""Grip controllers on scenes in a closed loop: what `holdfast loop` runs, and its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from holdfast.core.errors import UsageError
from holdfast.core.reading import Json
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.closed_loop import (
    CHOICES,
    LoopFigures,
    LoopRequest,
    LoopRuns,
    LoopSet,
    require_runnable,
)
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.closed_loop import model_of

FiguresByCard = dict[str, dict[str, LoopFigures]]
"""Scene -> controller -> its figures."""


@dataclass(frozen=True)
class LoopComparison:
    """Which controllers run on which scenes.

    setting: of every controller, None for the default of each. lag_ms: of the hand's drive.
    trials: how many of a scene, None for all.
    """

    model: ModelChoice
    cards: tuple[str, ...]
    controllers: tuple[str, ...]
    setting: float | None
    lag_ms: float
    trials: int | None
    seed: int

    def require_runnable(self) -> None:
        """Raise what would stop a run: UsageError, CardError, or a model that does not fit."""
        for name in self.controllers:
            if name not in CHOICES:
                raise UsageError(
                    f"--controller {name!r:.40} does not exist",
                    next_step=f"choose from {', '.join(CHOICES)}",
                )

        model = model_of(self.model)
        for card in self.cards:
            require_runnable(model, card)

    def run(self, workers: Workers, done: Callable[[float], None]) -> FiguresByCard:
        """Run every controller on every scene. done: gets the share of the work that is done."""
        runs = LoopRuns(self.model, workers, done)
        wanted = []
        for card in self.cards:
            loop_set = LoopSet(card, self.trials, self.seed)
            for name in self.controllers:
                request = LoopRequest(name, self.setting, self.lag_ms)
                wanted.append((loop_set, request))

        # All at once: scenes and bare hands that several requests need are run once.
        runs.run(wanted)

        figures: FiguresByCard = {}
        for loop_set, request in wanted:
            # By the name of the scene: a path would differ from machine to machine.
            of_card = figures.setdefault(Path(loop_set.card).stem, {})
            of_card[request.name] = runs.figures(loop_set, request)

        return figures

    def to_json(self, figures: FiguresByCard) -> Json:
        """The figures with all that they depend on."""
        sets = {}
        for card, of_card in figures.items():
            sets[card] = {name: one.to_json() for name, one in of_card.items()}

        return {
            "kind": "simulated",
            "model": model_of(self.model).card.model_id,
            "engine": self.model.engine,
            "lag_ms": self.lag_ms,
            "seed": self.seed,
            "trials": self.trials,
            "setting": self.setting,
            "sets": sets,
        }
