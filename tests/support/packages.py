"""The table of packages and who may call whom, and what a file imports."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def arrows() -> dict[str, list[str]]:
    """Room -> where its arrows lead, from the drawing in CONTRIBUTING.md, from the top down."""
    guide = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    drawing = guide.split("```text\n")[1].split("```")[0]
    found = {}
    for line in drawing.splitlines():
        words, _, ends = line.rpartition("->")
        found[words.split()[0]] = re.findall(r"\w+", ends.replace("nothing", ""))
    return found


def reached(room: str) -> set[str]:
    """Every room below a room."""
    ends = ARROWS[room]
    return set(ends).union(*map(reached, ends))


ARROWS = arrows()
SHIPPED = list(ARROWS)
"""The packages in holdfast/; the others are folders at the top, outside the wheel."""
MAY_IMPORT: dict[str, set[str]] = {
    **{room: reached(room) for room in SHIPPED},
    "benchmarks": {*SHIPPED, "tools"},
    "studies": {*SHIPPED, "tools", "benchmarks"},
    # the picture of the demo is drawn from its trials
    "tools": {*SHIPPED, "studies", "benchmarks", "examples"},
}
"""A package of ours, and the packages that it may import."""
HOUSE = {*MAY_IMPORT, "tests", "models", "examples"}


def loaded_by(program: str) -> set[str]:
    """The packages that a program has loaded when it ends, in a process of its own."""
    command = [sys.executable, "-c", f"{program}\nimport sys; print(*sys.modules)"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return {package_of(name) for name in done.stdout.split()}


def folder_of(package: str) -> Path:
    """Where the files of a package are."""
    return ROOT / "holdfast" / package if package in SHIPPED else ROOT / package


def calls_by_name(node: ast.AST) -> Iterator[str]:
    """The module in `import_module("x")` and `__import__("x")`."""
    if (
        isinstance(node, ast.Call)
        and node.args
        and isinstance(node.args[0], ast.Constant)
    ):
        called = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if called in {"import_module", "__import__"} and isinstance(
            node.args[0].value, str
        ):
            yield node.args[0].value


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """All of a file's syntax tree."""
    return tuple(ast.walk(ast.parse(path.read_text("utf-8"))))


def imports_of(source: str, package: str) -> set[str]:
    """Packages and other packages imported anywhere in the source, in functions too."""
    return imports_in(ast.walk(ast.parse(source)), package)


def imports_in(nodes: Iterable[ast.AST], package: str) -> set[str]:
    """The same of a syntax tree."""
    names: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module == "holdfast":
            names.update(f"holdfast.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names.add(package if node.level else node.module or "")
        else:
            names.update(calls_by_name(node))
    return {package_of(name) for name in names}


def package_of(module: str) -> str:
    """The package, or the package, that a module is in: holdfast.export.verify is in export."""
    first, _, rest = module.partition(".")
    inner = rest.split(".")[0]
    return inner if first == "holdfast" and inner in MAY_IMPORT else first


def imports_by_file(package: str) -> dict[str, set[str]]:
    files = sorted(folder_of(package).rglob("*.py"))
    return {str(f.relative_to(ROOT)): imports_in(nodes_of(f), package) for f in files}
