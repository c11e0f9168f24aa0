"""What the distortions should leave of the unchanged set's figures, beside what was measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from holdfast.core.contract import Json
from studies.distortions.table import UNCHANGED

LEAST_RECALL_CHANGE = -0.03
MOST_CALLED_CHANGE = 0.05
LEAST_OPEN_HAND = 0.99


class Worst(NamedTuple):
    """The row that is furthest from a target: its figure, and its name in words."""

    value: float
    words: str


def target_rows(before: Json, now: Json) -> list[dict[str, str]]:
    """A row a target: the worst distortion of the model before, and of the model now."""
    return [
        _row(
            "slips found beside unchanged, worst distortion",
            "at least -0.03",
            (before, now),
            lambda figures: _extreme(figures, "found_change", lowest=True),
            lambda value: value >= LEAST_RECALL_CHANGE,
        ),
        _row(
            "voluntary actions called beside unchanged, worst distortion",
            "at most +0.05",
            (before, now),
            lambda figures: _extreme(figures, "called_change", lowest=False),
            lambda value: value <= MOST_CALLED_CHANGE,
        ),
        _row(
            "quiet open hand is nothing, worst noise or drift",
            "at least 0.99",
            (before, now),
            _quietest,
            lambda value: value >= LEAST_OPEN_HAND,
        ),
    ]


def _row(
    target: str,
    aim: str,
    figures: tuple[Json, Json],
    worst: Callable[[Json], Worst],
    reaches: Callable[[float], bool],
) -> dict[str, str]:
    before, now = map(worst, figures)
    return {
        "target": target,
        "aim": aim,
        "before": f"{before.value:.2f}, {before.words}",
        "now": f"{now.value:.2f}, {now.words}",
        "reached": "yes" if reaches(now.value) else "no",
    }


def _extreme(figures: Json, key: str, *, lowest: bool) -> Worst:
    """The distortion whose figure is the lowest, or the highest."""
    found = []
    for row in figures["rows"]:
        if row["name"] != UNCHANGED and row[key] is not None:
            found.append(Worst(row[key], row["words"]))
    return min(found) if lowest else max(found)


def _quietest(figures: Json) -> Worst:
    """The quiet hand that is called nothing least."""
    found = []
    for row in figures["quiet"]:
        words = f"{row['noise_mn']:g} mN, {row['drift_mn_s']:g} mN/s"
        found.append(Worst(row["nothing"], words))
    return min(found)


def pairs_by_name(before: list[Json], now: list[Json]) -> list[dict[str, Json]]:
    """Rows that both runs have, side by side."""
    older = {row["name"]: row for row in before}
    pairs = []
    for row in now:
        if row["name"] in older:
            pairs.append({"before": older[row["name"]], "now": row})
    return pairs
