"""The tables of docs/safety.md, from how the tests went: `make safety`."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hard_cases_page import rows_of, trouble

from tools.doc_tables import write_between

Row = dict[str, Any]


def lists(results: list[Row]) -> str:
    """A table an area, a line a hazard."""
    sections = []
    for area in sorted({str(row["area"]) for row in results}):
        rows = [row for row in results if row["area"] == area]
        head = (
            f"### {area}\n\n"
            "| hazard | what the software does | left to the hand or to people |\n"
            "| --- | --- | --- |\n"
        )
        sections.append(head + "".join(_lines(rows)))
    return "\n".join(sections)


def _lines(rows: list[Row]) -> Iterable[str]:
    for hazard in dict.fromkeys(row["hazard"] for row in rows):
        tests = [row for row in rows if row["hazard"] == hazard]
        first = tests[0]
        yield f"| {hazard}{trouble(tests)} | {first['does']} | {first['left']} |\n"


if __name__ == "__main__":
    write_between(sys.argv[2], "hazards", lists(rows_of(Path(sys.argv[1]))))
