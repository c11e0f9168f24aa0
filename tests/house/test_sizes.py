"""Short functions, short files, and no two modules that import each other."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from statistics import median, quantiles

import pytest
from packages import MAY_IMPORT, ROOT, folder_of, nodes_of

FILES = sorted(
    path for package in MAY_IMPORT for path in folder_of(package).rglob("*.py")
)
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removeprefix(
        "holdfast."
    ): path
    for path in FILES
}
"""By name without the first word, which all of them share."""


def function_lines() -> dict[str, int]:
    """Lines of every function, its signature and docstring counted."""
    return {
        f"{path.relative_to(ROOT)}:{node.name}": (node.end_lineno or 0)
        - node.lineno
        + 1
        for path in FILES
        for node in nodes_of(path)
        if isinstance(node, ast.FunctionDef)
    }


def test_functions_are_short() -> None:
    """As in the code that we admire: a median of 4 to 12 lines, nine of ten under 40.

    Comments, blank lines and docstrings count, which is why the longest may have 65.
    """
    lines = function_lines()
    assert {name: n for name, n in lines.items() if n > 65} == {}
    assert median(lines.values()) <= 12
    assert quantiles(lines.values(), n=10)[-1] <= 40


def test_files_hold_one_idea() -> None:
    lines = {
        str(p.relative_to(ROOT)): len(p.read_text("utf-8").splitlines()) for p in FILES
    }
    assert {name: n for name, n in lines.items() if n > 600} == {}
    assert median(lines.values()) <= 200


def test_the_hand_written_c_is_short_too() -> None:
    templates = sorted((ROOT / "holdfast/export/c/templates").iterdir())
    assert {path.suffix for path in templates} == {".c", ".h"}
    for path in templates:
        lines = path.read_text("utf-8").splitlines()
        assert len(lines) <= 350, path
        starts = [
            k
            for k, line in enumerate(lines)
            if line.endswith("{") and line[:1].isalpha()
        ]
        ends = [
            next(k for k in range(at, len(lines)) if lines[k][:1] == "}")
            for at in starts
        ]
        assert all(end - at < 45 for at, end in zip(starts, ends, strict=True)), path


def imported(path: Path) -> set[str]:
    """Our modules that a file imports, in functions too."""
    names: set[str] = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
            names.add(node.module)
    return {name.removeprefix("holdfast.") for name in names} & set(MODULES)


def test_no_module_imports_one_that_imports_it() -> None:
    order = TopologicalSorter({name: imported(path) for name, path in MODULES.items()})
    try:
        order.prepare()
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))
