"""Sets as a user has them: `<person>/<object>/<action>/trial_<n>.csv`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from holdfast.core.trial_layout import META, truth_path
from holdfast.data.fixture import write_fixture


def write_people_folders(root: Path) -> Path:
    """Generated trials of p01 and p02: 16 of each, one of them the hand alone."""
    for number in (1, 2):
        person = root / f"p{number:02d}"
        write_fixture(person, trials_per_cell=1, seed=number)
        (person / META).unlink()
    write_meta(root, unit="N")
    return root


def write_phases(path: Path, *labels: str) -> Path:
    """A trial of noise at 50 Hz, sheared and pressed while it is held, with a truth of these
    situations, two seconds of each."""
    path.parent.mkdir(parents=True)
    n = 100 * len(labels)
    noise = np.random.default_rng(n).normal(0.0, 0.1, (n, 3))
    for number, label in enumerate(labels):
        noise[number * n // len(labels) :, 1:] += float(label != "nothing")
    rows = np.column_stack([np.arange(n) / 50.0, noise])
    np.savetxt(path, rows, delimiter=",", header="Time,X1,Y1,Z1", comments="")
    phases = []
    for number, label in enumerate(labels):
        start_s = 2.0 * number
        phases.append({"t0_s": start_s, "t1_s": start_s + 2.0, "label": label})
    truth_path(path).write_text(json.dumps({"phases": phases}), "utf-8")
    return path


def rewrite(path: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """A trial's table [T, columns], changed."""
    header = path.read_text().split("\n", 1)[0]
    table = change(np.loadtxt(path, delimiter=",", skiprows=1))
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")


def write_meta(folder: Path, **keys: object) -> None:
    """A meta.json with these keys."""
    (folder / META).write_text(json.dumps(keys), "utf-8")
