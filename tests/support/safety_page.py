"""The lists of docs/safety.md, from how the tests went: `make safety`."""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

from hard_cases_page import folded

from tools.doc_tables import write_between


def lists(results: list[dict[str, Any]]) -> str:
    """A section an area, a paragraph a hazard, a folded line a test."""
    parts = []
    for area, rows in groupby(
        sorted(results, key=lambda row: str(row["area"])), key=lambda row: row["area"]
    ):
        by_hazard: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            by_hazard.setdefault(row["hazard"], []).append(row)
        parts.append(
            f"## {area}\n\n"
            + "\n".join(_hazard(name, tests) for name, tests in by_hazard.items())
        )
    return "\n".join(parts)


def _hazard(name: str, rows: list[dict[str, Any]]) -> str:
    first = rows[0]
    left = f"*Left to the hand's own controller or to people:* {first['left']}."
    head = f"**{name}.** {first['does']}. {left}\n"
    lines = _lines(rows)
    ended = [row["outcome"] for row in rows]
    return head + "\n" + folded("\n".join(lines), len(lines), ended)


def _lines(rows: list[dict[str, Any]]) -> list[str]:
    outcomes: dict[str, list[str]] = {}
    for row in rows:
        outcomes.setdefault(row["test"].partition("[")[0], []).append(row["outcome"])
    return [_line(test, ended) for test, ended in outcomes.items()]


def _line(test: str, ended: list[str]) -> str:
    path, _, name = test.rpartition("::")
    counts = ", ".join(
        f"{ended.count(one)} {one}" if len(ended) > 1 else one
        for one in dict.fromkeys(ended)
    )
    sentence = name.removeprefix("test_").replace("_", " ")
    return f"- {sentence} (`{path.partition('::')[0]}`, {counts})"


if __name__ == "__main__":
    rows = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    write_between(sys.argv[2], "hazards", lists(rows))
