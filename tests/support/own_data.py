"""Sets as a user has them: `<person>/<object>/<action>/trial_<n>.csv`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from holdfast.core.trial_layout import META, truth_path
from holdfast.training.fixture import write_fixture


def write_people_folders(root: Path, people: int = 2) -> Path:
    """Generated trials of some people, p01 first: 16 of each, one of them the hand alone."""
    for number in range(1, people + 1):
        person = root / f"p{number:02d}"
        write_fixture(person, trials_per_cell=1, seed=number)
        (person / META).unlink()
    write_meta(root, unit="N")
    return root


def write_phases(path: Path, *labels: str, seconds: float = 2.0) -> Path:
    """A trial of noise at 50 Hz, sheared and pressed while it is held, with a truth of these
    situations, one after the other."""
    path.parent.mkdir(parents=True)
    n = round(50 * seconds * len(labels))
    noise = np.random.default_rng(n).normal(0.0, 0.1, (n, 3))
    for number, label in enumerate(labels):
        noise[number * n // len(labels) :, 1:] += float(label != "nothing")
    rows = np.column_stack([np.arange(n) / 50.0, noise])
    np.savetxt(path, rows, delimiter=",", header="Time,X1,Y1,Z1", comments="")
    phases = []
    for number, label in enumerate(labels):
        start_s = seconds * number
        phases.append({"t0_s": start_s, "t1_s": start_s + seconds, "label": label})
    truth_path(path).write_text(json.dumps({"phases": phases}), "utf-8")
    return path


def write_meta(folder: Path, **keys: object) -> None:
    """A meta.json with these keys."""
    (folder / META).write_text(json.dumps(keys), "utf-8")
