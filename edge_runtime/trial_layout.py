"""How a trial lies on disk, and what its words mean: file names, actions, objects, and when a hand touches something.

One owner for what recording, simulation, training and evaluation share::

    <object>/<action>/trial_<n>.csv          samples; beside it trial_<n>.truth.json, .onset.json, .frames.npz
    <object>/<action>/trial_<n>/             of the recorder: tactile.csv, events.jsonl, meta.json, tactile.truth.json
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from edge_runtime.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP, FloatArray, Unit
from edge_runtime.errors import LabelError
from edge_runtime.reading import json_of, text_of

META, EVENTS, TACTILE = "meta.json", "events.jsonl", "tactile.csv"
TRUTH_SUFFIX, ONSET_SUFFIX, FRAMES_SUFFIX = ".truth.json", ".onset.json", ".frames.npz"
TRUTH = "tactile" + TRUTH_SUFFIX

SITUATION_OF_ACTION = MappingProxyType({
    "pass": SAFE_SLIP, "put-down": SAFE_SLIP, "pull": RISKY_SLIP, "fall": RISKY_SLIP, "hold": GRASP,
    "nothing": NOTHING,
})  # fmt: skip
"""What an action makes of the grip, from load onset to the empty hand."""
VOLUNTARY_ACTIONS = tuple(name for name, situation in SITUATION_OF_ACTION.items() if situation == SAFE_SLIP)
RISKY_ACTIONS = tuple(name for name, situation in SITUATION_OF_ACTION.items() if situation == RISKY_SLIP)

MASSES_G = MappingProxyType({
    "soft-ball": 15.1, "empty-bottle": 21.2, "basket-ball": 83.1, "hard-ball": 197.9, "full-bottle": 517.3,
    "apple": 20.3,
})  # fmt: skip
"""The thesis' objects and its test object, g."""

NORMAL_FLOOR: MappingProxyType[Unit, float] = MappingProxyType({"N": 0.3, "uT": 100.0, "count": 300.0})
"""A finger whose normal reading is smaller touches nothing, in the stream's unit: above the noise of a resting channel.

No ratio is taken over less, and a resting normal below minus that is a magnet upside down."""

CONTACT_SHARE, CONTACT_SMOOTH_S = 0.1, 0.1
"""A hand is closed on something while its normal forces exceed this share of their own 95th percentile."""


def contact_rows(load: FloatArray, rate_hz: float, least: float = 0.0) -> tuple[int, int] | None:
    """First row with the hand closed on something, and first row after the last such; None where it met nothing.

    load [T]: sum of the fingers' normal forces, bias taken off; it is averaged over 0.1 s. least: a hand whose load
    never exceeds it has met nothing.
    """
    rows = max(1, round(CONTACT_SMOOTH_S * rate_hz))
    padded = np.pad(load, (rows // 2, (rows - 1) // 2), mode="symmetric")
    smooth = np.convolve(padded, np.full(rows, 1.0 / rows), mode="valid")
    high = float(np.quantile(smooth, 0.95))
    if high < least:
        return None
    closed = np.flatnonzero(smooth >= CONTACT_SHARE * high)
    return int(closed[0]), int(closed[-1]) + 1


def truth_path(trial: Path) -> Path:
    """`trial_3.csv` -> `trial_3.truth.json`."""
    return trial.with_suffix(TRUTH_SUFFIX)


def read_events(path: Path) -> list[dict[str, Any]]:
    """The lines of an events.jsonl, a torn last one left out; none without a file. Raises LabelError."""
    try:
        *lines, last = text_of(path).split("\n") if path.exists() else [""]
        events = [json_of(line) for line in [*lines, *_if_whole(last)] if line.strip()]
        if not all(isinstance(event, dict) for event in events):
            raise ValueError("no object")
        return events
    except (OSError, ValueError) as error:
        raise LabelError(
            f"a line is no JSON object ({type(error).__name__})", where=path, next_step="mend it"
        ) from None


def _if_whole(line: str) -> list[str]:
    """A last line without its newline, if it is whole: of a JSON object nothing but all of it is one."""
    try:
        json_of(line)
    except ValueError:
        return []
    return [line]
