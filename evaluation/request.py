"""The options of an evaluation. Imports no library, so that a command can read it at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.evaluation import MOST_FALSE_PER_MIN


@dataclass(frozen=True)
class EvaluationRequest:
    """The options of an evaluation.

    data: sets to score. choose: sets to choose the confidence on, if any. train: a set to train the
    raw-window forest on. groups: so many people (or blocks) only. people: these only, if any.
    """

    data: Sequence[str]
    choose: Sequence[str] = ()
    train: str | None = None
    groups: int | None = None
    people: frozenset[str] = frozenset()
    most_false_per_min: float = MOST_FALSE_PER_MIN
    seed: int = 0

    def n_stages(self) -> int:
        """How many stages `evaluate_events` announces."""
        a_set = 3 if self.choose else 4
        return bool(self.train) + 3 * bool(self.choose) + a_set * len(self.data) + 1
