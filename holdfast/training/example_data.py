"""The example files of docs/your-data.md: trials with gaps to fill, and a log to convert.

Generated as training/fixture.py generates, so no figure from them says anything about hands.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from holdfast.core.errors import OutputError
from holdfast.core.writing import require_writable, write_whole
from holdfast.training.fixture import write_fixture

TRIALS, LOGGER = "trials", "logger"
PEOPLE = ("p01", "p02", "p03")
OBJECTS = {"soft-ball": "soft-ball", "hard-ball": "mug"}
"""Objects of the fixture, and their names here: nothing knows the mass of a mug."""
EARLY_S = 2.0
"""All actions start so much before the script's time."""
SHORT_HOLD, HELD_S = "p03/mug/fall/trial_1.csv", (2.5, 4.0)
"""One trial does not follow the script: these seconds of its hold are left out."""
LOGGED = "p03/soft-ball/put-down/trial_1.csv"
FINGERS = ("thumb", "index", "middle", "ring", "little", "palm")
LOG_STARTS_MS = 120_000
Rows = list[list[str]]


def write_example(folder: Path) -> None:
    """Write `trials/<person>/<object>/<action>/trial_1.csv` and one log. Same bytes every time.

    Raises OutputError for a folder that holds something.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(
            "exists and is not empty", where=folder, next_step="name a new folder"
        )
    require_writable(folder)
    with TemporaryDirectory() as made:
        for seed, person in enumerate(PEOPLE, 1):
            source = Path(made) / person
            write_fixture(source, trials_per_cell=1, seed=seed, objects=tuple(OBJECTS))
            for path in sorted(source.rglob("trial_1.csv")):
                _write(folder, f"{person}/{path.relative_to(source).as_posix()}", path)


def _write(folder: Path, name: str, source: Path) -> None:
    for known, here in OBJECTS.items():
        name = name.replace(known, here)
    header, *rows = list(csv.reader(source.read_text("utf-8").splitlines()))
    if "nothing" not in name:
        rows = _without(rows, 0.0, EARLY_S)
    if name == SHORT_HOLD:
        rows = _without(rows, *HELD_S)
    if name == LOGGED:
        _write_csv(folder / LOGGER / "p03_soft-ball_put-down.csv", *_as_log(rows))
    else:
        _write_csv(folder / TRIALS / name, header, rows)


def _without(rows: Rows, start_s: float, stop_s: float) -> Rows:
    """The rows outside [start_s, stop_s), the later ones moved up."""
    kept = [row for row in rows if not start_s <= float(row[0]) < stop_s]
    return [
        _at(row, lambda t_s: t_s - (stop_s - start_s) * (t_s >= stop_s)) for row in kept
    ]


def _at(row: list[str], clock: Callable[[float], float]) -> list[str]:
    return [f"{clock(float(row[0])):.6f}", *row[1:]]


def _as_log(rows: Rows) -> tuple[list[str], Rows]:
    """The same as a logger of one's own writes it: ms, names of fingers, mN."""
    header = ["millis", *(f"{finger}_{axis}" for finger in FINGERS for axis in "xyz")]
    return header, [
        [
            f"{LOG_STARTS_MS + 1000 * float(row[0]):.0f}",
            *(f"{1000 * float(force_n):.1f}" for force_n in row[1:]),
        ]
        for row in rows
    ]


def _write_csv(path: Path, header: list[str], rows: Rows) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, "".join(",".join(row) + "\n" for row in [header, *rows]))
