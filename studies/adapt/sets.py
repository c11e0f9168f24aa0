"""Simulated sets of the study: of each unseen style, some persons' two minutes, and a test set."""

from __future__ import annotations

import re
from pathlib import Path

from holdfast.simulation import SCENES
from holdfast.simulation.folder import write_set
from holdfast.simulation.loop_recording import scene_of
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.recording import DataSet
from studies.shared_control.plan import CARDS as OTHER_CARDS

STYLES = ("p1", "p2", "quick", "slow")
"""The operating rule of `holdfast adapt` was chosen on p1 and p2; quick and slow came after it."""
PERSONS = 3
TEST_SEED, PERSON_SEED = 1003, 5000
TEST_TRIALS = 200
OWN_ROW = re.compile(r'action = "pass"\ncount = \d+\n(.*?)\n\n', re.DOTALL)


def person_set(style: str, number: int, folder: Path) -> DataSet:
    """The two minutes of one simulated person: the card `adapt`, acted in a style."""
    card = folder / f"adapt-{style}.toml"
    card.write_text(_adapt_card(style), encoding="utf-8")
    return _simulated(
        str(card), folder / f"{style}-{number}", PERSON_SEED + number, None
    )


def test_set(style: str, folder: Path) -> DataSet:
    """Pulls, falls, passes and put-downs of a style."""
    own = OTHER_CARDS / f"{style}.toml"
    return _simulated(
        str(own) if own.exists() else style, folder / style, TEST_SEED, TEST_TRIALS
    )


def _adapt_card(style: str) -> str:
    """The shipped card with the style's way of handing over."""
    text, own = (
        (SCENES / "adapt.toml").read_text("utf-8"),
        OTHER_CARDS / f"{style}.toml",
    )
    if not own.exists():
        return re.sub(r'(action = "\w[\w-]*"\n)', rf'\1style = "{style}"\n', text)
    row = OWN_ROW.search(own.read_text("utf-8"))
    assert row is not None
    kept = [
        one
        for one in row[1].split("\n")
        if not one.startswith(("close_at_s", "tail_s"))
    ]
    return text.replace(
        'action = "pass"\n', 'action = "pass"\n' + "\n".join(kept) + "\n"
    )


def _simulated(card: str, out: Path, seed: int, trials: int | None) -> DataSet:
    write_set(scene_of(read_scene_file(card), seed), out, trials, lambda n: None)
    return load(out, windows="none")
