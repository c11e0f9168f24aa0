"""A recording of another tool as trials of the layout: `<person>/<object>/<action>/trial_<n>.csv`.

Markers cut it and label it. `begin OBJECT/ACTION` (or `begin nothing`) starts a trial and `end`
ends it; without them the whole recording is one trial. A marker that is a situation starts that
phase, which lasts to the next of them or to the end. A sample that is missing between two stamps
becomes a gap in `sequence`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS, FloatArray, channel_names
from holdfast.core.errors import EmptyRecording, LabelError, TimeError, UnitError
from holdfast.core.reading import Json
from holdfast.core.trial_file import (
    LATEST_S,
    MIN_ROWS,
    MOST_LOST,
    TIME_COLUMN,
    places_by_time,
)
from holdfast.core.trial_layout import META, read_json, truth_path
from holdfast.core.writing import write_whole
from holdfast.interop.xdf import Marker, TactileStream
from holdfast.training.datasets.trials import EMPTY_HAND, FOLDERS

BEGIN, END = "begin ", "end"
PROVENANCE = "marker"


@dataclass(frozen=True)
class Cut:
    """A trial in a recording: [t0_s, t1_s) on its clock, and its folder below the person's."""

    t0_s: float
    t1_s: float
    folder: str


def cuts(markers: list[Marker], whole: str | None, where: Path) -> list[Cut]:
    """The trials that the markers begin and end, else the whole recording in one folder.

    whole: that folder, `<object>/<action>`. Raises LabelError.
    """
    begins = [one for one in markers if one.text.startswith(BEGIN)]
    if not begins:
        if whole is None:
            raise LabelError(
                "no marker begins a trial",
                where=where,
                next_step="--object NAME --action ACTION, or send 'begin OBJECT/ACTION' markers",
            )
        return [Cut(-np.inf, np.inf, _folder(whole, where))]
    ends = [one.t_s for one in markers if one.text == END or one in begins] + [np.inf]
    return [
        Cut(
            one.t_s,
            next(t_s for t_s in ends if t_s > one.t_s),
            _folder(one.text.removeprefix(BEGIN).strip(), where),
        )
        for one in begins
    ]


def _folder(text: str, where: Path) -> str:
    """`<object>/<action>` or `nothing`, checked. Raises LabelError."""
    thing, _, action = text.rpartition("/")
    plain = thing.replace("-", "").replace("_", "")
    if text != EMPTY_HAND and (
        action not in FOLDERS or not (plain.isascii() and plain.isalnum())
    ):
        raise LabelError(
            f"{text!r:.60} is not OBJECT/ACTION",
            where=where,
            next_step=f"letters, digits and dashes, then one of {', '.join(FOLDERS)}",
        )
    return text


def write_trials(
    stream: TactileStream, markers: list[Marker], found: list[Cut], person: Path
) -> list[Path]:
    """Write each cut as the next trial of its folder. person: <set>/<person>.

    Raises EmptyRecording, TimeError, or UnitError where the set has another unit.
    """
    tables = [_table(stream, one) for one in found]
    _require_unit(person.parent / META, stream)
    paths = []
    for one, (text, t0_s, t1_s) in zip(found, tables, strict=True):
        path = _next_trial(person / one.folder)
        write_whole(path, text)
        phases = list(_phases(markers, t0_s, t1_s))
        if phases:
            write_whole(
                truth_path(path), json.dumps({"phases": phases}, indent=1) + "\n"
            )
        paths.append(path)
    return paths


def _table(stream: TactileStream, cut: Cut) -> tuple[str, float, float]:
    """(CSV text, first stamp, last stamp) of a cut."""
    rows = (stream.t_s >= cut.t0_s) & (stream.t_s < cut.t1_s)
    stamps, values = stream.t_s[rows], stream.values[rows]
    if len(stamps) < MIN_ROWS:
        raise EmptyRecording(
            f"{len(stamps)} samples of trial {cut.folder}",
            where=stream.name,
            cause="the stream was not sent then, or its clock was not corrected",
            next_step="check the markers and the stream",
        )
    _require_time(stamps, stream.name)
    t_s = stamps - stamps[0]
    names = [TIME_COLUMN, *channel_names(values.shape[1] // 3), "sequence"]
    table, text = np.column_stack([t_s, values, places_by_time(t_s)]), io.StringIO()
    np.savetxt(text, table, "%.9g", ",", header=",".join(names), comments="")
    return text.getvalue(), float(stamps[0]), float(stamps[-1])


def _require_time(stamps: FloatArray, where: str) -> None:
    """Raise TimeError unless the stamps run forward and less than every other sample is missing."""
    steps = np.diff(stamps)
    if not (np.abs(stamps) < LATEST_S).all() or (steps <= 0.0).any():
        raise TimeError(
            "stamps stand still, run backwards or are no times",
            where=where,
            cause="the sender stamps blocks of samples alike, or its clock was set",
            next_step="stamp every sample",
        )
    expected = (stamps[-1] - stamps[0]) / float(np.median(steps))
    if expected > MOST_LOST * len(stamps):
        raise TimeError(
            f"{expected - len(stamps):.0f} samples are missing between {len(stamps)}",
            where=where,
            cause="the stream was interrupted",
            next_step="cut the recording there, by markers",
        )


def _require_unit(meta: Path, stream: TactileStream) -> None:
    """Write the unit into the set's meta.json, or require that it is the one there."""
    there = read_json(meta)
    if there.get("unit", stream.unit) != stream.unit:
        raise UnitError(
            f"the set is in {there['unit']}, the stream in {stream.unit}",
            where=meta,
            next_step="choose another folder",
        )
    if "unit" not in there:
        write_whole(meta, json.dumps({"unit": stream.unit} | there, indent=1) + "\n")


def _next_trial(folder: Path) -> Path:
    paths = (folder / f"trial_{number}.csv" for number in count(1))
    return next(path for path in paths if not path.exists())


def _phases(markers: list[Marker], t0_s: float, t1_s: float) -> Iterator[Json]:
    """Phases in s from the first sample, from the markers that are situations."""
    inside = [
        one for one in markers if one.text in SITUATIONS and t0_s <= one.t_s <= t1_s
    ]
    for one, after in pairwise([*inside, Marker(t1_s + 1e-6, END)]):
        yield {
            "t0_s": round(one.t_s - t0_s, 6),
            "t1_s": round(after.t_s - t0_s, 6),
            "label": one.text,
            "provenance": PROVENANCE,
        }
