"""XDF recordings (of LabRecorder, say) by pyxdf, which only this module imports.

Clocks are those of the recorder: pyxdf corrects the stamps of each stream by the clock offsets in
the file. Its removal of jitter is off, because a straight line through all stamps hides lost
samples.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import UNITS, FloatArray, Unit
from holdfast.core.errors import DataNotFound, NotANumber, listed, needs_extra
from holdfast.core.lsl_streams import StreamFacts, order_of, unit_of
from holdfast.core.reading import require_file

with needs_extra("xdf"):
    import pyxdf


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
    where the stream says it. Raises DataNotFound, NotANumber, ChannelError or UnitError.
    """
    streams = _loaded(path)
    markers = [
        Marker(t_s, str(row[0]))
        for stream in streams
        if stream.facts.is_text
        for t_s, row in zip(stream.t_s.tolist(), stream.rows, strict=True)
        if len(row)
    ]
    chosen = _chosen([one for one in streams if not one.facts.is_text], name, path)
    facts, where = chosen.facts, str(path)
    values = np.asarray(chosen.rows, dtype=np.float64)[:, order_of(facts.labels, where)]
    unit = unit or unit_of(facts.units, where, f"--unit {' or --unit '.join(UNITS)}")
    tactile = TactileStream(facts.name, chosen.t_s, values, unit)
    return tactile, sorted(markers, key=lambda one: one.t_s)


def _loaded(path: Path) -> list[_Stream]:
    require_file(path)
    if not path.is_file():
        raise DataNotFound("no such file", where=path, next_step="give an XDF file")
    opened = gzip.open if path.suffix == ".xdfz" else open
    try:
        with opened(path, "rb") as file, np.errstate(all="ignore"):
            streams = pyxdf.load_xdf(file, dejitter_timestamps=False)[0]
        return [_stream(one["info"], one) for one in streams]
    except Exception as error:  # pyxdf raises what its parsing meets
        raise NotANumber(
            f"cannot be read as XDF ({type(error).__name__}: {error})",
            where=path,
            cause="another format, or an interrupted copy",
            next_step="open it with another XDF reader to see what is left",
        ) from None


def _stream(info: Any, stream: Any) -> _Stream:
    described = info.get("desc") or [None]
    groups = (described[0] or {}).get("channels") or [None]
    count = int(info["channel_count"][0])
    found = (groups[0] or {}).get("channel") or [{}] * count
    if len(found) != count:
        found = [{}] * count
    labels, units = (
        tuple(str((one.get(key) or [""])[0] or "") for one in found)
        for key in ("label", "unit")
    )
    is_text = info["channel_format"][0] == "string"
    rate_hz = float(info["nominal_srate"][0])
    t_s = np.asarray(stream["time_stamps"], dtype=np.float64)
    facts = StreamFacts(str(info["name"][0]), is_text, rate_hz, labels, units)
    return _Stream(facts, t_s, stream["time_series"])


def _chosen(streams: list[_Stream], name: str | None, path: Path) -> _Stream:
    """The stream of this name, else the only one that can be tactile."""
    fit = [
        one
        for one in streams
        if (one.facts.name == name if name else len(one.facts.labels) % 3 == 0)
    ]
    if len(fit) == 1 and len(fit[0].t_s):
        return fit[0]
    what = (
        "no stream"
        if not fit
        else "no sample in the stream"
        if len(fit) == 1
        else "streams"
    )
    raise DataNotFound(
        f"{what} to read: {listed([one.facts.name for one in streams]) or 'none'} in the file",
        where=path,
        cause="another name, several streams of three channels, or an empty recording",
        next_step="name one: --stream NAME",
    )
