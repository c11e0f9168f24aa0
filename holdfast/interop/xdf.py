"""XDF recordings (such as LabRecorder's) as trials: `<person>/<object>/<action>/trial_<n>.csv`.

This module alone imports pyxdf. Clocks are those of the recorder: pyxdf corrects the stamps of each
stream by the clock offsets in the file. Its removal of jitter is off, because a straight line
through all stamps hides lost samples.

Markers cut a recording and label it. `begin OBJECT/ACTION` (or `begin nothing`) starts a trial and
`end` ends it; without them the whole recording is one trial. A marker that is a situation starts
that phase, which lasts to the next of them or to the end. A sample that is missing between two
stamps becomes a gap in `sequence`. `read_log` reads any file as columns, for `holdfast import`.
"""

from __future__ import annotations

import gzip
import io
import json
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import (
    SITUATIONS,
    UNITS,
    FloatArray,
    Json,
    Unit,
    channel_names,
)
from holdfast.core.errors import (
    DataNotFound,
    EmptyRecording,
    LabelError,
    NotANumber,
    TimeError,
    UnitError,
    listed,
    needs_extra,
)
from holdfast.core.lsl_streams import StreamFacts, order_of, unit_of
from holdfast.core.trial_file import (
    LATEST_S,
    MIN_ROWS,
    MOST_LOST,
    TIME_COLUMN,
    places_by_time,
)
from holdfast.core.trial_layout import META, read_json, truth_path
from holdfast.core.writing import write_whole
from holdfast.interop.logs.log import Columns, ForeignLog, Stream
from holdfast.training.datasets.trials import EMPTY_HAND, FOLDERS

with needs_extra("xdf"):
    import pyxdf

BEGIN, END = "begin ", "end"
"""Markers that begin and end a trial."""
PROVENANCE = "marker"
"""What the truth file says of where a phase comes from."""
SAME_S = 1e-6
"""A marker this near to a sample is at it: clocks are fitted, and end in rounded numbers."""


@dataclass(frozen=True)
class TactileStream:
    """A stream: t_s [T] on the recorder's clock, values [T, C] in the layout's order."""

    name: str
    t_s: FloatArray
    values: FloatArray
    unit: Unit


@dataclass(frozen=True)
class Marker:
    """A text of a marker stream, t_s on the recorder's clock."""

    t_s: float
    text: str


@dataclass(frozen=True)
class _Stream:
    """A stream as the file has it: stamps [T] and rows."""

    facts: StreamFacts
    t_s: FloatArray
    rows: Any


def read_xdf(
    path: Path, name: str | None = None, unit: Unit | None = None
) -> tuple[TactileStream, list[Marker]]:
    """The tactile stream of a file, and all markers in their order.

    name: of the stream; None where only one has a multiple of three numeric channels. unit: None
    where the stream names it. Raises DataNotFound, NotANumber, ChannelError or UnitError.
    """
    numeric = []
    markers = []
    for stream in _loaded(path):
        if stream.facts.is_text:
            markers.extend(_markers(stream))
        else:
            numeric.append(stream)
    markers.sort(key=lambda marker: marker.t_s)

    chosen = _chosen(numeric, name, path)
    facts = chosen.facts
    where = str(path)
    values = np.asarray(chosen.rows, dtype=np.float64)
    # The sender may list its channels in any order; the labels say which is which.
    values = values[:, order_of(facts.labels, where)]

    if unit is None:
        options = " or --unit ".join(UNITS)
        unit = unit_of(facts.units, where, f"--unit {options}")
    return TactileStream(facts.name, chosen.t_s, values, unit), markers


def _markers(stream: _Stream) -> list[Marker]:
    """The texts of a marker stream."""
    markers = []
    for t_s, row in zip(stream.t_s.tolist(), stream.rows, strict=True):
        # A row without any channel carries no text.
        if len(row):
            markers.append(Marker(t_s, str(row[0])))
    return markers


def _loaded(path: Path) -> list[_Stream]:
    """All streams of a file, `.xdf` or compressed `.xdfz`. Raises DataNotFound or NotANumber."""
    if not path.is_file():
        raise DataNotFound("no such file", where=path, next_step="give an XDF file")

    opened = gzip.open if path.suffix == ".xdfz" else open
    try:
        # Damaged stamps may overflow in pyxdf; _require_time refuses them, in words.
        with opened(path, "rb") as file, np.errstate(all="ignore"):
            streams = pyxdf.load_xdf(file, dejitter_timestamps=False)[0]
        return [_stream(stream["info"], stream) for stream in streams]
    except Exception as error:  # pyxdf raises whatever its parsing meets
        raise NotANumber(
            f"cannot be read as XDF ({type(error).__name__}: {error})",
            where=path,
            cause="another format, or an interrupted copy",
            next_step="open it with another XDF reader to see what is left",
        ) from None


def _stream(info: Any, stream: Any) -> _Stream:
    """A stream of pyxdf with the facts of its header.

    Every level of an XDF header is a list, which may be absent, empty or hold None.
    """
    described = info.get("desc") or [None]
    groups = (described[0] or {}).get("channels") or [None]
    channels = (groups[0] or {}).get("channel") or []

    n_channels = int(info["channel_count"][0])
    if len(channels) != n_channels:
        # A list of another length cannot say which name belongs to which channel.
        channels = [{}] * n_channels

    labels = [_text(channel, "label") for channel in channels]
    units = [_text(channel, "unit") for channel in channels]

    facts = StreamFacts(
        str(info["name"][0]),
        info["channel_format"][0] == "string",
        float(info["nominal_srate"][0]),
        tuple(labels),
        tuple(units),
    )

    t_s = np.asarray(stream["time_stamps"], dtype=np.float64)
    return _Stream(facts, t_s, stream["time_series"])


def _text(channel: Any, key: str) -> str:
    """A text in the header of a channel, empty where it is missing."""
    texts = channel.get(key) or [""]
    return str(texts[0] or "")


def _chosen(streams: list[_Stream], name: str | None, path: Path) -> _Stream:
    """The stream of this name, else the only one that can be tactile. Raises DataNotFound."""
    if name:
        fit = [stream for stream in streams if stream.facts.name == name]
    else:
        # A fingertip has three axes, so tactile streams have a multiple of three channels.
        fit = [stream for stream in streams if len(stream.facts.labels) % 3 == 0]

    if not fit:
        what = "no stream"
    elif len(fit) > 1:
        what = "streams"
    elif len(fit[0].t_s) == 0:
        what = "no sample in the stream"
    else:
        return fit[0]

    names = listed([stream.facts.name for stream in streams]) or "none"
    raise DataNotFound(
        f"{what} to read: {names} in the file",
        where=path,
        cause="another name, several streams of three channels, or an empty recording",
        next_step="name one: --stream NAME",
    )


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
    bounds = []
    for marker in markers:
        if marker.text == END or marker.text.startswith(BEGIN):
            bounds.append(marker)

    found = []
    for marker in bounds:
        if marker.text == END:
            continue
        folder = _folder(marker.text.removeprefix(BEGIN).strip(), where)
        # A trial without its own `end` lasts to the next beginning, or to the last sample.
        later = [bound.t_s for bound in bounds if bound.t_s > marker.t_s]
        found.append(Cut(marker.t_s, min(later, default=np.inf), folder))
    if found:
        return found

    if whole is None:
        raise LabelError(
            "no marker begins a trial",
            where=where,
            next_step="--object NAME --action ACTION, or send 'begin OBJECT/ACTION' markers",
        )
    return [Cut(-np.inf, np.inf, _folder(whole, where))]


def _folder(text: str, where: Path) -> str:
    """`<object>/<action>` or `nothing`, checked. Raises LabelError."""
    name, _, action = text.rpartition("/")
    # The text comes from outside and becomes a path: no dots, no separators.
    plain = name.replace("-", "").replace("_", "")

    is_name = plain.isascii() and plain.isalnum()
    is_place = is_name and action in FOLDERS

    if text != EMPTY_HAND and not is_place:
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
    # All tables are made first, so that a fault in the last leaves no trial behind.
    tables = [_table(stream, cut) for cut in found]
    _require_unit(person.parent / META, stream)

    paths = []
    for cut, (text, t0_s, t1_s) in zip(found, tables, strict=True):
        path = _next_trial(person / cut.folder)
        write_whole(path, text)

        phases = _phases(markers, t0_s, t1_s)
        # Without a marker the script of the action labels the trial, as for every other trial.
        if phases:
            truth = json.dumps({"phases": phases}, indent=1)
            write_whole(truth_path(path), truth + "\n")
        paths.append(path)
    return paths


def _table(stream: TactileStream, cut: Cut) -> tuple[str, float, float]:
    """(CSV text, first stamp, last stamp) of a cut. Raises EmptyRecording or TimeError."""
    inside = (stream.t_s >= cut.t0_s - SAME_S) & (stream.t_s < cut.t1_s - SAME_S)
    stamps = stream.t_s[inside]
    if len(stamps) < MIN_ROWS:
        raise EmptyRecording(
            f"{len(stamps)} samples of trial {cut.folder}",
            where=stream.name,
            cause="the stream was not sent then, or its clock was not corrected",
            next_step="check the markers and the stream",
        )
    _require_time(stamps, stream.name)

    # A trial counts from its first sample; the stamps of a recorder count from its start.
    t_s = stamps - stamps[0]
    values = stream.values[inside]

    # A sample that is missing leaves a gap in `sequence`, which readers take as a lost sample.
    names = [TIME_COLUMN, *channel_names(values.shape[1] // 3), "sequence"]
    table = np.column_stack([t_s, values, places_by_time(t_s)])

    # The whole table is made in memory: a fault in it leaves no half file.
    text = io.StringIO()
    header = ",".join(names)
    # Nine digits keep every digit of a float32, and 10 us in a recording of an hour.
    np.savetxt(text, table, "%.9g", ",", header=header, comments="")
    return text.getvalue(), float(stamps[0]), float(stamps[-1])


def _require_time(stamps: FloatArray, where: str) -> None:
    """Raise TimeError unless the stamps run forward and less than every other sample is missing."""
    steps = np.diff(stamps)
    are_times = (np.abs(stamps) < LATEST_S).all()  # nan and infinity are none
    if not are_times or (steps <= 0.0).any():
        raise TimeError(
            "stamps stand still, run backwards or are no times",
            where=where,
            cause="the sender stamps blocks of samples alike, or its clock was set",
            next_step="stamp every sample",
        )

    # The median step is that of the sender, whatever was lost in between.
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
    # A set has one unit: trials in another would be read as forces of another size.
    there = read_json(meta)
    if "unit" not in there:
        described = {"unit": stream.unit} | there
        write_whole(meta, json.dumps(described, indent=1) + "\n")
    elif there["unit"] != stream.unit:
        raise UnitError(
            f"the set is in {there['unit']}, the stream in {stream.unit}",
            where=meta,
            next_step="choose another folder",
        )


def _next_trial(folder: Path) -> Path:
    """The first free `trial_<n>.csv`: a second import adds trials and overwrites none."""
    for number in count(1):
        path = folder / f"trial_{number}.csv"
        if not path.exists():
            break
    return path


def _phases(markers: list[Marker], t0_s: float, t1_s: float) -> list[Json]:
    """Phases in s from the first sample, from the markers that are situations."""
    # From the last marker to the first, because each phase ends where the next one begins.
    phases: list[Json] = []
    # The last phase ends just after the last sample, so that this sample is part of it.
    stop_s = t1_s + SAME_S
    for marker in reversed(markers):
        within = t0_s - SAME_S <= marker.t_s <= t1_s
        if marker.text not in SITUATIONS or not within:
            continue
        phase = {
            "t0_s": round(max(0.0, marker.t_s - t0_s), 6),
            "t1_s": round(stop_s - t0_s, 6),
            "label": marker.text,
            "provenance": PROVENANCE,
        }
        phases.insert(0, phase)
        stop_s = marker.t_s
    return phases


def read_log(path: Path, name: str) -> ForeignLog:
    """Any XDF file as a log: a stream with columns `stream.channel`; of markers, one of texts.

    Raises DataNotFound, NotANumber or TimeError.
    """
    streams = []
    for stream in _loaded(path):
        facts = stream.facts
        if not len(stream.t_s):
            continue
        if not (np.abs(stream.t_s) < LATEST_S).all():
            raise TimeError(f"stamps of {facts.name:.60} are no times", where=path)
        columns: Columns = {}
        if facts.is_text:
            texts = [str(row[0]) if len(row) else "" for row in stream.rows]
            columns[facts.name] = np.array(texts, dtype=object)
        else:
            values = np.asarray(stream.rows, dtype=np.float64)
            for k, label in enumerate(facts.labels):
                columns[f"{facts.name}.{label or k}"] = values[:, k]
        t_ns = np.round(stream.t_s * 1e9).astype(np.int64)
        streams.append(Stream(columns, t_ns))
    return ForeignLog(path, name, tuple(streams))
