"""The targets of the fast hand-over study beside what the default and the best change reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from holdfast.core.reading import Json


@dataclass(frozen=True)
class Target:
    """A figure that was aimed at, before the study. places: keys into a row; the worst counts."""

    name: str
    aim: float
    places: tuple[str, ...]
    at_least: bool = True

    def reached(self, row: Json) -> float | None:
        """The worst of the row's figures; None where one is missing."""
        values = [_at(row, place) for place in self.places]
        if None in values:
            return None
        return min(values) if self.at_least else max(values)

    def better(self, one: float, other: float) -> bool:
        """Whether `one` beats `other`."""
        return one > other if self.at_least else one < other


TARGETS = (
    Target("macro F1, trials held out", 0.97, ("f1_author",)),
    Target("macro F1, unseen style (worse of p1 and p2)", 0.94, ("f1_p1", "f1_p2")),
    Target("macro F1, worst object left out", 0.88, ("worst_object",)),
    Target(
        "recall, worse of author and disturbed holds",
        0.99,
        ("author.recall", "asked-holds.recall"),
    ),
    Target(
        "false alarms per min, disturbed holds",
        0.5,
        ("asked-holds.false_per_min",),
        at_least=False,
    ),
    Target("recall, unseen styles", 0.99, ("unseen_style.recall",)),
    Target(
        "false alarms per min, unseen styles",
        1.0,
        ("unseen_style.false_per_min",),
        at_least=False,
    ),
    Target(
        "voluntary actions called risky, author",
        0.05,
        ("author.safe_acts_called.share",),
        at_least=False,
    ),
    Target(
        "voluntary actions called risky, fast hand-overs (p1)",
        0.25,
        ("p1.safe_acts_called.share",),
        at_least=False,
    ),
    Target(
        "ms from load onset to the first risky state, median",
        7.0,
        ("state_delay_ms.p50",),
        at_least=False,
    ),
    Target(
        "specificity, disturbed grip (dFn)",
        0.95,
        ("asked-holds.specificity.dFn.share",),
    ),
    Target(
        "specificity, disturbed load (dFt)",
        0.95,
        ("asked-holds.specificity.dFt.share",),
    ),
    Target(
        "specificity, moved motor (dq)", 0.95, ("asked-holds.specificity.dq.share",)
    ),
)


def target_rows(rows: list[Json]) -> list[Json]:
    """Each target beside the default (the first row) and the best of all changes."""
    return [_row(target, rows) for target in TARGETS]


def _row(target: Target, rows: list[Json]) -> Json:
    reached = {
        row["idea"]: value for row in rows if (value := target.reached(row)) is not None
    }
    default = reached[rows[0]["idea"]]
    best = rows[0]["idea"]
    for name, value in reached.items():
        best = name if target.better(value, reached[best]) else best
    return {
        "target": target.name,
        "aim": f"{'>=' if target.at_least else '<='} {target.aim:g}",
        "default": default,
        "reached": "no" if target.better(target.aim, default) else "yes",
        "best": reached[best],
        "best change": best,
    }


def _at(row: Json, place: str) -> Any:
    here: Any = row
    for key in place.split("."):
        here = None if here is None else here.get(key)
    return here
