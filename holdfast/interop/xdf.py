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

from edge_runtime.contract import UNITS, FloatArray, Unit, channel_names
from edge_runtime.errors import ChannelError, DataNotFound, NotANumber, UnitError
from edge_runtime.extras import needs_extra
from edge_runtime.reading import require_file
from edge_runtime.visible import listed

with needs_extra("xdf"):
    import pyxdf

UNIT_WORDS: dict[str, Unit] = {
    "n": "N",
    "newton": "N",
    "newtons": "N",
    "ut": "uT",
    "µt": "uT",
    "microtesla": "uT",
    "count": "count",
    "counts": "count",
}
"""What streams write for a unit, in lower case."""


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
    """A stream as the file has it; channels: label and unit of each, empty where not described."""

    name: str
    is_text: bool
    t_s: FloatArray
    rows: Any
    channels: list[dict[str, str]]


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
        if stream.is_text
        for t_s, row in zip(stream.t_s.tolist(), stream.rows, strict=True)
        if len(row)
    ]
    chosen = _chosen([one for one in streams if not one.is_text], name, path)
    values = np.asarray(chosen.rows, dtype=np.float64)[:, _order(chosen.channels, path)]
    tactile = TactileStream(chosen.name, chosen.t_s, values, unit or _unit(chosen.channels, path))
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
    channels = [
        {key: str((one.get(key) or [""])[0] or "") for key in ("label", "unit")} for one in found
    ]
    if len(channels) != count:
        channels = [{"label": "", "unit": ""}] * count
    is_text = info["channel_format"][0] == "string"
    t_s = np.asarray(stream["time_stamps"], dtype=np.float64)
    return _Stream(str(info["name"][0]), is_text, t_s, stream["time_series"], channels)


def _chosen(streams: list[_Stream], name: str | None, path: Path) -> _Stream:
    """The stream of this name, else the only one that can be tactile."""
    fit = [one for one in streams if (one.name == name if name else len(one.channels) % 3 == 0)]
    if len(fit) == 1 and len(fit[0].t_s):
        return fit[0]
    what = "no stream" if not fit else "no sample in the stream" if len(fit) == 1 else "streams"
    raise DataNotFound(
        f"{what} to read: {listed([one.name for one in streams]) or 'none'} in the file",
        where=path,
        cause="another name, several streams of three channels, or an empty recording",
        next_step="name one: --stream NAME",
    )


def _order(channels: list[dict[str, str]], path: Path) -> list[int]:
    """Where X1, Y1, Z1, .. are: by their labels if these are the layout's, else as they come."""
    labels, count = [one["label"] for one in channels], len(channels)
    if count % 3:
        raise ChannelError(
            f"{count} channels, not a multiple of three",
            where=path,
            next_step="record x, y, z of each sensor, or name another stream: --stream NAME",
        )
    names = channel_names(count // 3)
    return [labels.index(name) for name in names] if set(labels) == {*names} else [*range(count)]


def _unit(channels: list[dict[str, str]], path: Path) -> Unit:
    said = {one["unit"].strip().lower() for one in channels}
    units = {UNIT_WORDS.get(word) for word in said}
    (unit,) = units if len(units) == 1 else (None,)
    if unit is None:
        raise UnitError(
            f"the stream does not say its unit ({listed(sorted(said - {''})) or 'nothing'})",
            where=path,
            next_step=f"--unit {' or --unit '.join(UNITS)}",
        )
    return unit
