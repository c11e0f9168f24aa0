"""The tables of docs/hard-cases.md, from how the tests went: `make hard-cases`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hard_cases import AREAS

from tools.doc_tables import write_between

Row = dict[str, Any]


def rows_of(path: Path) -> list[Row]:
    """How each test went, in the order of their names, whatever order they ran in."""
    rows: list[Row] = json.loads(path.read_text("utf-8"))
    return sorted(rows, key=lambda row: str(row["test"]))


def lists(results: list[Row]) -> str:
    """A table an area, a line a case."""
    sections = []
    for area in AREAS:
        rows = [row for row in results if row["area"] == area]
        if rows:
            head = f"### {area}\n\n| case | elsewhere | here |\n| --- | --- | --- |\n"
            sections.append(head + "".join(_lines(rows)))
    return "\n".join(sections)


def _lines(rows: list[Row]) -> Iterable[str]:
    for case in dict.fromkeys(row["case"] for row in rows):
        tests = [row for row in rows if row["case"] == case]
        first = tests[0]
        yield f"| {case}{trouble(tests)} | {first['elsewhere']} | {first['here']} |\n"


def trouble(tests: list[Row]) -> str:
    """What is appended where not all tests passed, variants counted: " (1 failed)"."""
    outcomes = [row["outcome"] for row in tests if row["outcome"] != "passed"]
    counted = (f"{outcomes.count(one)} {one}" for one in dict.fromkeys(outcomes))
    return f" ({', '.join(counted)})" if outcomes else ""


if __name__ == "__main__":
    write_between(sys.argv[2], "hard-cases", lists(rows_of(Path(sys.argv[1]))))
