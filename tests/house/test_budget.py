"""The budget of the house (tools/budget.toml): how much ships, how much stands around it, and how
many modules a program loads. `python -m tools.house` prints the same figures.
"""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from packages import ROOT

from tools.house import WALKS, budget, modules_loaded, size_figures

LIMITS = budget()
# counted by the first test that asks, not by each process that only collects
figures_now = cache(size_figures)
ONE_SAMPLE = """
import socket, sys, threading
from holdfast.cli.main import main

entered = set()

def note(frame, event, argument):
    entered.add(frame.f_code.co_filename)

hand = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
hand.bind("hand")
threading.setprofile(note)
sys.setprofile(note)
words = "run --source virtual://ft232h --seconds 0.2 --to none --grip unix://" + sys.argv[1]
code = main(words.split())
sys.setprofile(None)
print(*entered, sep="\\n")
sys.exit(code)
"""


@pytest.mark.parametrize("walk", WALKS)
def test_a_program_loads_few_modules(walk: str, tmp_path: Path) -> None:
    assert modules_loaded(WALKS[walk], tmp_path) <= LIMITS["walks"][walk]


def test_what_ships_stays_within_the_sum_of_the_packages() -> None:
    """The sum counts: a package may borrow what another leaves."""
    nodes = figures_now()["packages"]
    assert nodes.keys() == LIMITS["packages"].keys()
    assert sum(nodes.values()) <= sum(LIMITS["packages"].values())


@pytest.mark.parametrize("section", ["shipped", "outside"])
def test_what_is_written_stays_within_its_budget(section: str) -> None:
    figures, limits = figures_now()[section], LIMITS[section]
    assert figures.keys() == limits.keys()
    assert {name: n for name, n in figures.items() if n > limits[name]} == {}


def test_a_sample_goes_from_the_bus_to_the_grip_through_the_files_of_the_guide(
    tmp_path: Path,
) -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    route = re.findall(r"^\d+\. `(holdfast/.*\.py)`", guide, re.MULTILINE)
    assert 10 <= len(route) <= 14
    done = subprocess.run(
        [sys.executable, "-c", ONE_SAMPLE, str(tmp_path / "hand")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    entered = done.stdout.split()
    assert [one for one in route if str(ROOT / one) not in entered] == []
