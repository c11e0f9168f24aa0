"""Keeps what the collection of tests has loaded out of every garbage collection.

Some million objects of modules and tests live until the end. A full collection walks over all of
them, and the tests cause hundreds; frozen, these objects cost nothing. While they are loaded, next
to nothing is garbage, so the collector rests.
"""

from __future__ import annotations

import gc
from collections.abc import Generator

import pytest


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect the tests without the garbage collector."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Freeze what is there; the garbage collector still sees everything that a test makes."""
    _freeze()


@pytest.fixture(scope="module", autouse=True)
def _frozen_again() -> None:
    """Freeze what the files before have loaded as they ran; what is garbage is collected first."""
    _freeze()


def _freeze() -> None:
    gc.collect()
    gc.freeze()
