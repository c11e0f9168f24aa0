"""Sets as a user has them: `<person>/<object>/<action>/trial_<n>.csv`."""

from __future__ import annotations

import json
from pathlib import Path

from holdfast.core.trial_layout import META
from holdfast.training.fixture import write_fixture


def write_people_folders(root: Path, people: int = 2) -> Path:
    """Generated trials of some people, p01 first: 16 of each, one of them the hand alone."""
    for number in range(1, people + 1):
        person = root / f"p{number:02d}"
        write_fixture(person, trials_per_cell=1, seed=number)
        (person / META).unlink()
    write_meta(root, unit="N")
    return root


def write_meta(folder: Path, **keys: object) -> None:
    """A meta.json with these keys."""
    (folder / META).write_text(json.dumps(keys), "utf-8")
