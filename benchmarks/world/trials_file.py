"""The trials that are done, a JSON line each, so that a run that was stopped goes on.

The first line says what the others were run with. A file of another seed, model, controller or
version of the code is not continued: it is put aside, and the run begins anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from holdfast.core.contract import Json

ROOT = Path(__file__).resolve().parents[2]
CODE = (
    "benchmarks/world",
    "holdfast/core",
    "holdfast/edge_runtime",
    "holdfast/live",
    "holdfast/simulation",
)
"""Folders whose Python can change a trial."""
NAMES = ("program", "scores", "trials_file", "picture")
"""Modules of benchmarks/world that cannot."""


class TrialsFile:
    """A file of records. about: what they are run with. put_aside: an older file was."""

    def __init__(self, path: Path, about: Json) -> None:
        self.path = path
        self.done: dict[str, Json] = {}
        self.put_aside = False
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = list(_whole_lines(path))
        if lines and lines[0] != about:
            path.replace(path.with_suffix(".old.jsonl"))
            self.put_aside = True
            lines = []
        self.done = {one["name"]: one for one in lines[1:]}

        # Written anew, so that a line torn by a kill is gone.
        whole = [about, *self.done.values()]
        path.write_text("".join(map(_line, whole)), encoding="utf-8")

    def add(self, record: Json) -> None:
        """One more trial, on the disk when this returns."""
        self.done[record["name"]] = record
        with self.path.open("a", encoding="utf-8") as file:
            file.write(_line(record))

    def of(self, names: Sequence[str]) -> list[Json]:
        """The records of these trials, in this order."""
        return [self.done[name] for name in names]


def _line(one: Json) -> str:
    return json.dumps(one, allow_nan=False) + "\n"


def _whole_lines(path: Path) -> Iterator[Json]:
    """The objects of a file up to the first line that is not whole."""
    if not path.is_file():
        return
    for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
        if not line.endswith("\n"):
            return
        try:
            yield json.loads(line)
        except ValueError:
            return


def code_sha256() -> str:
    """Of all sources that can change a trial."""
    found = hashlib.sha256()
    for folder in CODE:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if folder == CODE[0] and path.stem in NAMES:
                continue
            found.update(path.relative_to(ROOT).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()


def file_sha256(path: Path) -> str:
    """Of one file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
