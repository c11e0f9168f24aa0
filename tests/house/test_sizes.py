"""Short functions, short files, and no two modules that import each other."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

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


def code_lines(text: list[str], node: ast.FunctionDef) -> int:
    """Lines of a function without its docstring, comments and blank lines; text: of its file."""
    docstring: set[int] = set()
    if ast.get_docstring(node) is not None:
        first = node.body[0]
        docstring = set(range(first.lineno, (first.end_lineno or 0) + 1))
    count = 0
    for number in range(node.lineno, (node.end_lineno or 0) + 1):
        line = text[number - 1].strip()
        if number not in docstring and line and not line.startswith("#"):
            count += 1
    return count


def function_lines() -> dict[str, int]:
    """Lines of code of every function, its signature counted."""
    lines = {}
    for path in FILES:
        text = path.read_text("utf-8").splitlines()
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef):
                name = f"{path.relative_to(ROOT)}:{node.name}"
                lines[name] = code_lines(text, node)
    return lines


def test_functions_are_short() -> None:
    """Reasons and paragraphs cost nothing here: only code counts."""
    lines = function_lines()
    assert {name: n for name, n in lines.items() if n > 60} == {}


def test_files_hold_one_idea() -> None:
    lines = {
        str(p.relative_to(ROOT)): len(p.read_text("utf-8").splitlines()) for p in FILES
    }
    assert {name: n for name, n in lines.items() if n > 600} == {}


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


def only_for_types(path: Path) -> set[ast.AST]:
    """What stands under `if TYPE_CHECKING`: it is never imported when the program runs."""
    found: set[ast.AST] = set()
    for node in nodes_of(path):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for statement in node.body:
                found.update(ast.walk(statement))
    return found


def imported(path: Path) -> set[str]:
    """Our modules that a file imports, in functions too."""
    names: set[str] = set()
    for node in set(nodes_of(path)) - only_for_types(path):
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
