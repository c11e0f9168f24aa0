"""A parameter of a card: a constant, a choice, or a distribution, drawn once a trial.

grip_n = 8.0
grip_n = { uniform = [6, 10] }
grip_n = { normal = [8, 1] }            # mean and standard deviation, kept within the allowed range
grip_n = { log_uniform = [0.1, 10] }
grip_n = { choice = [4, 8, 12] }
sensors = [2, 5]                        # for a parameter that is a list
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Drawer = Callable[[np.random.Generator, list[float]], float]

DISTRIBUTIONS: dict[str, Drawer] = {
    "uniform": lambda rng, p: float(rng.uniform(p[0], p[1])),
    "normal": lambda rng, p: float(rng.normal(p[0], p[1])),
    "log_uniform": lambda rng, p: float(
        math.exp(rng.uniform(math.log(p[0]), math.log(p[1])))
    ),
    "choice": lambda rng, p: float(p[int(rng.integers(len(p)))]),
}
LENGTHS = {"uniform": 2, "normal": 2, "log_uniform": 2}


@dataclass(frozen=True)
class Parameter:
    """One parameter: its default, its unit, and the range that values and draws keep within.

    about: what it is. many: the value is a list of numbers (such as sensors), not one number.
    """

    default: Any
    unit: str
    low: float
    high: float
    about: str
    many: bool = False

    def allowed(self) -> str:
        """The range in words, for errors and tables."""
        what = "a list of numbers" if self.many else "a number"
        return f"{what} from {self.low:g} to {self.high:g}{f' {self.unit}' if self.unit else ''}"

    def problem(self, value: Any) -> str | None:
        """What is wrong with a card's value, or None."""
        if self.many:
            fits = isinstance(value, list) and all(self._inside(item) for item in value)
            return None if fits else self.allowed()
        if isinstance(value, dict):
            return self._problem_of_distribution(value)
        return None if self._inside(value) else f"{self.allowed()}, or a distribution"

    def draw(self, value: Any, rng: np.random.Generator) -> Any:
        """One draw of a value that has no problem; a constant uses no random number."""
        if self.many:
            return [float(item) for item in value]
        if not isinstance(value, dict):
            return float(value)
        ((kind, numbers),) = value.items()
        return min(max(DISTRIBUTIONS[kind](rng, numbers), self.low), self.high)

    def _inside(self, value: Any) -> bool:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and self.low <= value <= self.high  # false of nan

    def _problem_of_distribution(self, value: dict[str, Any]) -> str | None:
        kinds = ", ".join(DISTRIBUTIONS)
        if len(value) != 1 or next(iter(value)) not in DISTRIBUTIONS:
            return f"{self.allowed()}, or one of {{ {kinds} }}"
        ((kind, numbers),) = value.items()
        if (
            not isinstance(numbers, list)
            or len(numbers) != LENGTHS.get(kind, len(numbers))
            or not numbers
        ):
            return f"{kind} = [{'mean, standard deviation' if kind == 'normal' else 'low, high'}]"
        if kind == "normal":
            spread = (
                isinstance(numbers[1], (int, float))
                and 0 <= numbers[1] <= sys.float_info.max
            )
            fits = self._inside(numbers[0]) and spread
            return (
                None
                if fits
                else f"a mean within {self.allowed()} and a standard deviation that is not negative"
            )
        if not all(self._inside(number) for number in numbers):
            return f"limits within {self.allowed()}"
        if kind != "choice" and not numbers[0] <= numbers[1]:
            return "low before high"
        return (
            "limits above zero" if kind == "log_uniform" and numbers[0] <= 0 else None
        )
