"""The option of studies that names sets which are there already, and the sets that two share."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from holdfast.cli.command import path_argument
from holdfast.core.locked import require_open
from tools.harness import SimulatedSet, simulate_sets

CHOSEN_ON = "choose"
"""The folder on which these studies choose thresholds."""
STREAMS = [
    SimulatedSet("thesis", "thesis", 500, 0),
    SimulatedSet("broad", "broad", 500, 0),
    SimulatedSet(CHOSEN_ON, "daily", 370, 1007),
    SimulatedSet("author", "thesis", 300, 1000),
    SimulatedSet("p1", "p1", 450, 1003),
    SimulatedSet("p2", "p2", 450, 1004),
    SimulatedSet("asked-holds", "perturbed-hold", 300, 1005),
]
"""Models are trained on seed 0; no other set has a seed of these."""


def add_sets_option(parser: argparse.ArgumentParser) -> None:
    """--sets: a folder in which the sets are already."""
    parser.add_argument(
        "--sets",
        type=path_argument,
        metavar="DIR",
        help="holds the simulated sets already (default: simulated into --out)",
    )


def sets_folder(given: Path | None, sets: Sequence[SimulatedSet], out: Path) -> Path:
    """The folder of the sets, which are simulated into `out` where none is given."""
    if given is not None:
        require_open(given / CHOSEN_ON, "a threshold")
        return given
    simulate_sets(sets, out)
    return out
