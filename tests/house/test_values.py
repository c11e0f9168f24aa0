"""Figures cross functions and packages as values that nothing changes."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHANGED_IN_PLACE = {"GripSense", "Group", "Handle", "Traffic"}


def unfrozen(text: str) -> set[str]:
    """Names of the dataclasses of a file whose fields can be set."""
    classes = [one for one in ast.walk(ast.parse(text)) if type(one) is ast.ClassDef]
    return {
        one.name
        for one in classes
        for form in map(ast.unparse, one.decorator_list)
        if form.startswith("dataclass") and "frozen=True" not in form
    }


def test_values_of_the_core_the_live_path_and_the_drivers_are_frozen() -> None:
    found: set[str] = set()
    for package in ("core", "edge_runtime", "drivers"):
        for path in sorted((ROOT / "holdfast" / package).rglob("*.py")):
            found |= unfrozen(path.read_text("utf-8"))
    assert found == CHANGED_IN_PLACE
