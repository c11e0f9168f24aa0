"""The tables of docs/safety.md, made of how the tests went: `make safety`. The prose around them is
the page's own."""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- hazards: written by `make safety` -->\n", "<!-- /hazards -->"


def tables(results: list[dict[str, Any]]) -> str:
    """A section an area, a row a hazard, with its tests below."""
    parts = []
    for area, rows in groupby(
        sorted(results, key=lambda row: str(row["area"])), key=lambda row: row["area"]
    ):
        by_hazard: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            by_hazard.setdefault(row["hazard"], []).append(row)
        parts.append(
            f"## {area}\n\n" + "\n".join(_hazard(name, tests) for name, tests in by_hazard.items())
        )
    return "\n".join(parts)


def _hazard(name: str, rows: list[dict[str, Any]]) -> str:
    first = rows[0]
    head = f"**{name}.** {first['does']}. *Left to the hand's own controller or to people:* {first['left']}.\n"
    return "\n".join([head, *_lines(rows)]) + "\n"


def _lines(rows: list[dict[str, Any]]) -> list[str]:
    outcomes: dict[str, list[str]] = {}
    for row in rows:
        outcomes.setdefault(row["test"].partition("[")[0], []).append(row["outcome"])
    return [_line(test, told) for test, told in outcomes.items()]


def _line(test: str, told: list[str]) -> str:
    path, _, name = test.rpartition("::")
    counts = ", ".join(
        f"{told.count(one)} {one}" if len(told) > 1 else one for one in dict.fromkeys(told)
    )
    return (
        f"- {name.removeprefix('test_').replace('_', ' ')} (`{path.partition('::')[0]}`, {counts})"
    )


def rewritten(page: str, results: list[dict[str, Any]]) -> str:
    """The page with new tables between its markers. Raises ValueError where it has none."""
    before, after = page.index(BEGIN) + len(BEGIN), page.index(END)
    return page[:before] + tables(results) + page[after:]


if __name__ == "__main__":
    written, target = json.loads(Path(sys.argv[1]).read_text("utf-8")), Path(sys.argv[2])
    target.write_text(rewritten(target.read_text("utf-8"), written), encoding="utf-8")
