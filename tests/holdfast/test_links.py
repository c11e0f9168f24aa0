"""The links at the top are other names of the package's modules, never copies."""

from __future__ import annotations

import sys
from importlib import import_module

import pytest

from holdfast.core import links

PAIRS = (
    "drivers.layout",
    "edge_runtime.decision",
    "export.spec",
    "training.windows",
)


@pytest.mark.parametrize("name", PAIRS)
def test_a_module_by_its_short_name_is_the_package_s_own(name: str) -> None:
    short = import_module(name)
    assert short is import_module(f"holdfast.{name}")
    spec = short.__spec__
    assert spec is not None
    assert spec.name == f"holdfast.{name}"
    assert spec.origin == short.__file__


def test_a_module_that_is_not_there_is_missed_by_its_own_name() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"holdfast\.training\.nowhere"):
        import_module("training.nowhere")


def test_a_link_finds_its_own_modules_alone() -> None:
    import_module("training.windows")
    (finder,) = [
        one
        for one in sys.meta_path
        if isinstance(one, links._Link) and one._prefix == "training."
    ]
    assert finder.find_spec("numpy.windows", None) is None
    found = finder.find_spec("training.windows", None)
    assert found is not None
    assert found.loader is finder


def test_a_link_goes_before_every_other_finder(monkeypatch: pytest.MonkeyPatch) -> None:
    """One before it would load a second copy of a module from the package's own folder."""
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    links.link("edge_runtime")
    assert isinstance(sys.meta_path[0], links._Link)
    assert sys.modules["edge_runtime"] is import_module("holdfast.edge_runtime")
