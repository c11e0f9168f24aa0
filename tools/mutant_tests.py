"""Which test files try a change of a module, and which test noticed it."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

PYTHON = Path(__file__).resolve().parents[1] / ".venv/bin/python"
FOLDERS = (
    "edge_runtime",
    "drivers",
    "training",
    "holdfast",
    "simulation",
    "export",
    "fuzz",
)
"""Folders of tests/ that test these packages; not those of studies, pages and the house."""
LONG_FILES = "tests/support/longest_first.py"
"""The list of slow test files there: these are tried where they have the name of the module."""
LONGEST_CHAIN = 3
MOST_FILES = 10
TOGETHER = 3
"""Test files for a module, and how many of them one command runs."""
OF_EVERY_MODULE = "tests/house/test_values.py"


def naming_tests(module: Path) -> list[str]:
    """The test files that name a module, then those of what imports it; best match first.

    A file names a module too where it imports what supports the tests and that names it. The
    module itself is added where it holds doctests, and the test of all values.
    """
    modules = texts("holdfast", "**/*.py")
    files = {
        name: text
        for folder in FOLDERS
        for name, text in texts(f"tests/{folder}", "test_*.py").items()
    }
    slow = set(re.findall(r'"(test_\w+)"', Path(LONG_FILES).read_text("utf-8")))
    words = (*module.parts[2:-1], module.stem)
    near = f"tests/{module.parts[1]}/"

    def is_named(name: str) -> bool:
        return any(word in Path(name).stem for word in words)

    ranked: list[str] = []
    importers = {str(module)}
    for _ in range(LONGEST_CHAIN):
        found: dict[str, int] = {}
        for one in map(Path, sorted(importers)):
            found = relayed(one, files) | found | mentions(one, files)
        keys = {
            name: (not is_named(name), not name.startswith(near), -times, name)
            for name, times in found.items()
            if is_named(name) or Path(name).stem not in slow
        }
        ranked += sorted(keys.keys() - {*ranked}, key=keys.__getitem__)
        importers = {name for one in importers for name in mentions(Path(one), modules)}
    own = [str(module)] if ">>> " in modules[str(module)] else []
    return [OF_EVERY_MODULE, *own, *ranked[:MOST_FILES]]


def relayed(module: Path, files: dict[str, str]) -> dict[str, int]:
    """Files that import a module of tests/support that names a module, each once."""
    support = mentions(module, texts("tests/support", "*.py"))
    stems = "|".join(Path(one).stem for one in support)
    imports = re.compile(rf"^(?:from|import) (?:{stems})\b", re.MULTILINE)
    return {name: 1 for name, text in files.items() if stems and imports.search(text)}


def mentions(module: Path, files: dict[str, str]) -> dict[str, int]:
    """Files that import a module, with how often the names of its package's module occur."""
    dotted = ".".join(module.with_suffix("").parts).removesuffix(".__init__")
    parent, _, stem = dotted.rpartition(".")
    imports = (
        rf"{re.escape(dotted)}\b(?!\.)|from {re.escape(parent)} import [^\n]*\b{stem}\b"
    )
    return {
        name: text.count(stem)
        for name, text in files.items()
        if re.search(imports, text)
    }


@cache
def texts(folder: str, pattern: str) -> dict[str, str]:
    """The files of a folder of the tree, by name."""
    return {
        str(path): path.read_text("utf-8")
        for path in sorted(Path(folder).glob(pattern))
    }


def command_of(names: list[str]) -> str:
    """The command that runs test files, until one fails."""
    return f"{PYTHON} -m pytest -p no:xdist -p no:cacheprovider -q -x {' '.join(names)}"


def failures(output: str) -> set[str]:
    """Tests that failed by pytest's short summary, without parameters; or files not collected."""
    return set(re.findall(r"^(?:FAILED|ERROR) ([^\s\[]+)", output, re.MULTILINE))


def noticing(output: str) -> str:
    """The first test that failed; empty where none did, or none began."""
    return min(failures(output), default="")
