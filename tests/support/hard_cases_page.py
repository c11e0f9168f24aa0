"""The lists of docs/hard-cases.md, from how the tests went: `make hard-cases`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from hard_cases import AREAS

from tools.doc_tables import write_between


def lists(results: list[dict[str, Any]]) -> str:
    """A section an area, a paragraph a case, a folded line a test."""
    sections = []
    for area in AREAS:
        rows = [row for row in results if row["area"] == area]
        cases = dict.fromkeys(row["case"] for row in rows)
        if cases:
            texts = (
                _case(case, [row for row in rows if row["case"] == case])
                for case in cases
            )
            sections.append(f"## {area}\n\n" + "\n".join(texts))
    return "\n\n".join(sections) + "\n"


def _case(case: str, rows: list[dict[str, Any]]) -> str:
    first = rows[0]
    by_test = dict.fromkeys(row["test"].partition("[")[0] for row in rows)
    lines = "\n".join(
        _line([row for row in rows if row["test"].partition("[")[0] == test])
        for test in by_test
    )
    ended = [row["outcome"] for row in rows]
    head = f"### {case}\n\nElsewhere: {first['elsewhere']}. Here: {first['here']}.\n\n"
    return head + folded(lines, len(by_test), ended)


def folded(lines: str, tests: int, outcomes: list[str]) -> str:
    """The lines of tests behind one that says how many there are and how all their runs ended."""
    counts = {outcome: outcomes.count(outcome) for outcome in dict.fromkeys(outcomes)}
    ended = (
        next(iter(counts))
        if len(counts) == 1
        else ", ".join(map(_times, counts, counts.values()))
    )
    title = f"{tests} test{'s' * (tests > 1)}: {ended}"
    return (
        f'<details markdown="1"><summary>{title}</summary>\n\n{lines}\n\n</details>\n'
    )


def _line(rows: list[dict[str, Any]]) -> str:
    """One test, all its variants."""
    name = rows[0]["test"].partition("[")[0].rpartition("::")[2]
    outcomes = [row["outcome"] for row in rows]
    counts = {outcome: outcomes.count(outcome) for outcome in dict.fromkeys(outcomes)}
    outcome = (
        outcomes[0]
        if len(rows) == 1
        else ", ".join(map(_times, counts, counts.values()))
    )
    begins = "without: " if rows[0]["unguarded"] else ""
    measured = "; ".join(
        f"{key.replace('_', ' ')} {_short(value)}"
        for key, value in _measured(rows).items()
    )
    sentence = name.removeprefix("test_").replace("_", " ")
    return f"- {outcome}: {begins}{sentence}" + (f" ({measured})" if measured else "")


def _times(outcome: str, count: int) -> str:
    return f"{outcome} once" if count == 1 else f"{outcome} {count} times"


def _measured(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the variants recorded, the largest of each figure."""
    figures: dict[str, Any] = {}
    for row in rows:
        for key, value in row["measured"].items():
            figures[key] = max(figures.get(key, value), value)
    return figures


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    rows = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    write_between(sys.argv[2], "hard-cases", lists(rows))
