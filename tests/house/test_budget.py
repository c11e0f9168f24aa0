"""The budget of the house (tools/budget.toml): how much ships, how much stands around it, and how
many modules a program loads. `python -m tools.house` prints the same figures.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.house import WALKS, budget, modules_loaded, package_nodes, size_figures

LIMITS = budget()


@pytest.mark.parametrize("walk", WALKS)
def test_a_program_loads_few_modules(walk: str, tmp_path: Path) -> None:
    assert modules_loaded(WALKS[walk], tmp_path) <= LIMITS["walks"][walk]


def test_what_ships_stays_within_the_sum_of_the_packages() -> None:
    """The sum counts: a package may borrow what another leaves."""
    assert package_nodes().keys() == LIMITS["packages"].keys()
    assert sum(package_nodes().values()) <= sum(LIMITS["packages"].values())


@pytest.mark.parametrize("section", ["shipped", "outside"])
def test_what_is_written_stays_within_its_budget(section: str) -> None:
    figures, limits = size_figures()[section], LIMITS[section]
    assert figures.keys() == limits.keys()
    assert {name: n for name, n in figures.items() if n > limits[name]} == {}
