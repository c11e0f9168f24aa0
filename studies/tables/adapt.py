"""The tables of docs/adapt.md: `python -m studies.tables.adapt STYLES PEOPLE PAGE`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from edge_runtime.reading import Json
from evaluation.doc_tables import with_interval, write_tables
from evaluation.page import markdown


def tables(styles: Json, people: Json) -> dict[str, str]:
    """Every style and every way; people likewise."""
    rows = [
        _style_row(style, name, way)
        for style, one in styles["styles"].items()
        for name, way in one["ways"].items()
    ]
    return {
        "styles": markdown(rows),
        "people": markdown([_people_row(name, way) for name, way in people["ways"].items()]),
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
        "false alarms per min (95 %)": with_interval(way["false_per_min"], way["false_per_min_ci"]),
    }


def _number(value: float | None) -> str | None:
    return None if value is None else f"{value:.3f}"


def main(styles: Path, people: Path, page: Path) -> None:
    """Write the tables into the page."""
    read = [json.loads(path.read_text("utf-8")) for path in (styles, people)]
    write_tables(page, tables(*read))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
