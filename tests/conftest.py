"""What several tests need: the public data sets, where they are."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from edge_runtime.errors import DataNotFound
from training.datasets import find


@pytest.fixture(scope="session")
def real_set() -> Callable[[str], Path]:
    """Folder of a public set by name; without it the test skips, or fails if HOLDFAST_REQUIRE_DATA=1."""

    def folder(name: str) -> Path:
        try:
            return find(name)
        except DataNotFound as absent:
            line = str(absent)
        if os.environ.get("HOLDFAST_REQUIRE_DATA") == "1":
            pytest.fail(line, pytrace=False)
        pytest.skip(line)

    return folder
