"""The tables of docs/adapt.md: `python -m studies.tables.adapt STYLES PEOPLE PAGE`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown
from tools.doc_tables import Tables, refresh, with_interval


def _styles(figures: Json) -> Tables:
    """Every style and every way."""
    rows = [
        _style_row(style, name, way)
        for style, one in figures["styles"].items()
        for name, way in one["ways"].items()
    ]
    return {"styles": markdown(rows)}


def _people(figures: Json) -> Tables:
    """Every way."""
    return {
        "people": markdown(
            [_people_row(name, way) for name, way in figures["ways"].items()]
        )
    }


def _style_row(style: str, name: str, way: Json) -> dict[str, str | None]:
    called = [one[0] for one in way["by_person"]]
    return {
        "style": style,
        "file": name,
        "voluntary called (95 %)": with_interval(way["called"], way["called_ci"]),
        "persons": f"{min(called):.3f} to {max(called):.3f}",
        **_alarms(way),
        "before gross slip": _number(way["before_gross_slip"]),
    }


def _people_row(name: str, way: Json) -> dict[str, str | None]:
    f1 = way["macro_f1"]
    return {
        "file": name,
        "macro F1 (95 %)": with_interval(f1["value"], f1["ci"]),
        **_alarms(way),
    }


def _alarms(way: Json) -> dict[str, str | None]:
    return {
        "recall (95 %)": with_interval(way["recall"], way["recall_ci"]),
        "false alarms per min (95 %)": with_interval(
            way["false_per_min"], way["false_per_min_ci"]
        ),
    }


def _number(value: float | None) -> str | None:
    return None if value is None else f"{value:.3f}"


MADE_FROM: tuple[Callable[[Json], Tables], ...] = (_styles, _people)
"""Of the JSON files, in the order of the command's arguments."""

if __name__ == "__main__":
    *sources, page = sys.argv[1:]
    refresh(page, dict(zip(map(Path, sources), MADE_FROM, strict=True)))
