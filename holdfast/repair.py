"""`holdfast repair DIR`: mend trials that a kill or a power cut broke off, and say what was done.

A torn last line of tactile.csv or events.jsonl is taken away, and a trial that still says `recording` says
`interrupted` from then on. Nothing else is touched, and nothing that was whole is lost.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from edge_runtime.command import place
from edge_runtime.errors import DataError, OutputError
from edge_runtime.tactile_file import mend
from edge_runtime.writing import write_whole
from holdfast.recorder.folder import INTERRUPTED, RECORDING, all_trials, alone
from holdfast.recorder.labels import EVENTS, META, TACTILE, read_meta


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("folder", type=place, metavar="DIR", help="a trial's folder, or one with trials in it")


def run(args: argparse.Namespace) -> int:
    """Mend every trial below the folder; a line each, and the exit code of data where one could not be."""
    code = 0
    with alone(args.folder):
        for folder in all_trials(args.folder):
            try:
                print(f"{folder}: {', '.join(repaired(folder)) or 'whole'}")
            except DataError as error:
                print(f"{folder}: not mended: {error}")
                code = error.exit_code
    return code


def repaired(folder: Path) -> list[str]:
    """Mend one trial; what was done, in words. Raises a DataError or OutputError."""
    mended = mend(folder / TACTILE)
    torn = f"{mended.cut_bytes} bytes of a torn line taken away, {mended.rows} samples whole"
    said = [torn] if mended.cut_bytes else []
    cut = _mend_events(folder / EVENTS)
    said += [f"{cut} bytes of a torn event taken away"] if cut else []
    meta = read_meta(folder)
    if meta.get("state") == RECORDING:
        told = {**meta, "state": INTERRUPTED, "why": f"cut off; mended, {mended.rows} samples"}
        write_whole(folder / META, json.dumps(told, indent=1) + "\n")
        said.append(f"marked as interrupted with {mended.rows} samples")
    return said


def _mend_events(path: Path) -> int:
    try:
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.truncate(path, whole)
        return len(data) - whole
    except FileNotFoundError:
        return 0
    except OSError as error:
        raise OutputError(f"cannot be mended ({error.strerror})", where=path, next_step="copy it, mend that") from None
