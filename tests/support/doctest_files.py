"""Leaves out modules of packages without an example: looking for one loads and walks all of them.

The packages are among the test paths for their doctests alone, and few modules have one.
"""

from __future__ import annotations

from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PROMPT = ">>>"


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Whether a file has nothing to collect; None where pytest decides."""
    if collection_path.suffix != ".py" or TESTS in collection_path.parents:
        return None
    return None if PROMPT in collection_path.read_text("utf-8") else True
