"""Rows of the tables of docs/results.md: an older model's figures beside a newer one's."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.world.draws import KINDS, RISKY
from benchmarks.world.picture import picture
from benchmarks.world.ranges import TABLE
from holdfast.core.contract import Json

BEFORE = Path("docs/measured/world-d86a7e638b14.json")
NOW = Path("docs/measured/world-080828f74eb1.json")
VOLUNTARY = tuple(kind for kind in KINDS if kind not in RISKY)
GROUPS = ("pulls and tugs", "falls", "all drops")


def columns(before: Any, now: Any) -> list[Json]:
    """The figures that are there, the older first; one model twice is shown once, the newer."""
    there = [one for one in (before, now) if isinstance(one, dict)]
    ran = [(one["code_sha256"], one["model"]) for one in there]
    if len(there) == 2 and ran[0] == ran[1]:
        there = there[1:]
    names = {one["model"]["id"] for one in there}
    return [{**one, "label": _label(one, len(names) < len(there))} for one in there]


def _label(figures: Json, same: bool) -> str:
    """The model's identifier; where another column has the same model, the commit too."""
    name: str = figures["model"]["id"]
    return f"{name}, {figures['commit']}" if same else name


def rows(
    figures: Sequence[Json], table: str, names: Sequence[str] | None = None
) -> Iterator[Json]:
    """Rows of a table of the first set of each column, a name after the other, with the model."""
    tables = [one["tables"][0][table] for one in figures]
    key = {"hand_overs": "opens", "quiet": "hold"}.get(table, "kind")
    for name in names or [row[key] for row in tables[0]] if tables else []:
        for one, found in zip(figures, tables, strict=True):
            for row in found:
                if row[key] == name:
                    yield {**row, "model": one["label"]}


def drops(figures: Sequence[Json]) -> list[Json]:
    """Kinds in which an object can be dropped, then their groups."""
    return [*rows(figures, "kinds", RISKY), *rows(figures, "groups", GROUPS)]


def calm(figures: Sequence[Json]) -> list[Json]:
    """Kinds in which the hand should do nothing."""
    both = rows(figures, "groups", ("both hand-overs",))
    return [*rows(figures, "kinds", VOLUNTARY), *both]


def sets(figures: Sequence[Json]) -> list[Json]:
    """All drops and all hand-overs by pads and sensors, where a run had more than one set."""
    made = []
    for one in figures:
        for table in one["tables"] if len(one["tables"]) > 1 else []:
            found = {row["kind"]: row for row in (*table["kinds"], *table["groups"])}
            made.append(
                {
                    "model": one["label"],
                    "pads": table["pads"],
                    "sensors": table["sensors"],
                    "drops": found["all drops"],
                    "pulls": found["pulls and tugs"],
                    "over": found["both hand-overs"],
                    "held": found["tug-held"],
                }
            )
    return made


def targets(figures: Sequence[Json]) -> list[Json]:
    """The aims of issue 34, and what was measured."""
    made = []
    for what, table, name, figure, sign, aim in AIMS:
        for row in rows(figures, table, (name,)):
            share = row[f"{figure}_share"]
            reached = None if share is None else sign * share >= sign * aim
            made.append(
                {
                    "what": what,
                    "aim": f"{'at least' if sign > 0 else 'at most'} {aim:.2f}",
                    "model": row["model"],
                    "share": share,
                    "share_ci": row[f"{figure}_share_ci"],
                    "of": row[f"{figure}_of"],
                    "reached": reached,
                }
            )
    return made


AIMS = (
    ("preventable drops saved, all", "groups", "all drops", "saved", 1, 0.8),
    ("the same of pulls and tugs", "groups", "pulls and tugs", "saved", 1, 0.6),
    ("without earlier tightening", "groups", "all drops", "saved_fresh", 1, 0.7),
    ("hand-overs called", "groups", "both hand-overs", "called", -1, 0.2),
    ("pick-ups called", "kinds", "pick-up", "called", -1, 0.05),
    ("held tugs called", "kinds", "tug-held", "called", -1, 0.2),
    ("command above need", "groups", "all trials", "too_much", -1, 0.05),
)
"""(what, table, row, figure, 1 for at least or -1 for at most, aim)."""


def ranges() -> list[Json]:
    """The table of what is drawn."""
    return [asdict(one) for one in TABLE]


def draw(before: Json) -> str:
    """The picture: the shipped model's run beside the older one."""
    return picture(columns(before, json.loads(NOW.read_text("utf-8"))))


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "world_columns": columns,
    "world_rows": rows,
    "world_drops": drops,
    "world_calm": calm,
    "world_sets": sets,
    "world_targets": targets,
    "world_ranges": ranges,
}
"""What the template of the page calls."""
