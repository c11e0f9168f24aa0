"""The repair of one trial's folder, for `holdfast repair`."""

from __future__ import annotations

import json
from pathlib import Path

from holdfast.edge_runtime.errors import EmptyRecording, OutputError
from holdfast.edge_runtime.mending import MendResult, mend_lines
from holdfast.edge_runtime.reading import Json, json_of
from holdfast.edge_runtime.tactile_file import mend
from holdfast.edge_runtime.trial_layout import EVENTS, META, TACTILE
from holdfast.edge_runtime.writing import write_whole
from holdfast.recorder.folder import FORMAT, INTERRUPTED, KEPT, RECORDING, VOID
from holdfast.recorder.labels import read_meta


def repaired(folder: Path) -> list[str]:
    """Repair one trial; returns what was done, in words.

    Raises a DataError or OutputError; what is whole in the trial is then unchanged.
    """
    try:
        return _repaired(folder)
    except OutputError as error:
        step = "make room, then run holdfast repair again"
        raise OutputError(
            error.what, where=error.where, cause=error.cause, next_step=step
        ) from None


def _repaired(folder: Path) -> list[str]:
    meta = read_meta(folder)
    try:
        mended = mend(folder / TACTILE)
    except EmptyRecording:
        if meta.get("state") == KEPT:
            raise
        return _voided(folder, meta)
    done = _in_words(mended, f"incomplete line removed, {mended.rows} samples complete")
    if (folder / EVENTS).exists():
        done += _in_words(mend_lines(folder / EVENTS, _is_event), "incomplete event removed")
    if meta.get("state") == RECORDING:
        _mark(folder, meta, INTERRUPTED, f"cut off; mended, {mended.rows} samples")
        done.append(f"marked as interrupted with {mended.rows} samples")
    return done


def _voided(folder: Path, meta: Json) -> list[str]:
    """A trial that ended before its header: marked as void, once."""
    begun = meta.get("state") == RECORDING or (not meta and (folder / TACTILE).exists())
    if begun:
        _mark(folder, {"recorder": FORMAT, **meta}, VOID, "cut off before its header was written")
        return ["marked as void: it ended before its header was written"]
    return [f"{meta.get('state', 'not a trial')}: no sample was recorded"]


def _mark(folder: Path, meta: Json, state: str, why: str) -> None:
    write_whole(folder / META, json.dumps({**meta, "state": state, "why": why}, indent=1) + "\n")


def _in_words(mended: MendResult, what: str) -> list[str]:
    if mended.torn is None:
        return []
    return [f"{mended.cut_bytes} bytes of an {what}", f"they are in {mended.torn.name}"]


def _is_event(line: bytes) -> bool:
    """Whether a line is a complete JSON object."""
    try:
        return isinstance(json_of(line), dict)
    except ValueError:
        return False
