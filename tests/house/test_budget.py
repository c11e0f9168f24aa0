"""The budget of the house (tools/budget.toml): how much is written, and how many modules a program
loads. `python -m tools.house` prints the same figures.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from packages import ROOT

from tools.house import LIMITED, WALKS, budget, limited_nodes, modules_loaded

LIMITS = budget()
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


@pytest.mark.parametrize("name", LIMITED)
def test_what_is_written_stays_below_its_limit(name: str) -> None:
    nodes, most = limited_nodes()[name], LIMITS["nodes"][name]
    assert nodes <= most, (
        f"{name}: {nodes:,} nodes, {nodes - most:,} above the limit. Take out what nobody uses, or "
        f"raise the limit in tools/budget.toml in the same commit and say for what."
    )


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


def test_what_the_guide_says_to_touch_for_an_addition_is_there() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = guide.partition("**To add ..**")[2].partition("- **Small**")[0]
    kinds = re.findall(r"^- an? \*\*(.+)\*\*:", section, re.MULTILINE)
    wanted = "chip bridge output effect feature set verb grip_rule"
    assert " ".join(kind.replace(" ", "_") for kind in kinds) == wanted
    paths = re.findall(r"`([\w./-]+(?:\.\w+|/))`", section)
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []
