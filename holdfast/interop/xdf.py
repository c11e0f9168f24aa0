"""XDF recordings (such as LabRecorder's) as logs, for `holdfast import`.

This module alone imports pyxdf. Clocks are those of the recorder: pyxdf corrects the stamps of each
stream by the clock offsets in the file. Its removal of jitter is off, because a straight line
through all stamps hides lost samples.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import DataNotFound, NotANumber, TimeError, needs_extra
from holdfast.core.trial_file import LATEST_S
from holdfast.interop.logs.log import Columns, ForeignLog, Stream

with needs_extra("xdf"):
    import pyxdf


@dataclass(frozen=True)
class _Stream:
    """A stream as the file has it: stamps [T], rows, and the labels of its channels."""

    name: str
    is_text: bool
    labels: tuple[str, ...]
    t_s: FloatArray
    rows: Any


def _loaded(path: Path) -> list[_Stream]:
    """All streams of a file, `.xdf` or compressed `.xdfz`. Raises DataNotFound or NotANumber."""
    if not path.is_file():
        raise DataNotFound("no such file", where=path, next_step="give an XDF file")

    opened = gzip.open if path.suffix == ".xdfz" else open
    try:
        # Damaged stamps may overflow in pyxdf; read_log refuses them, in words.
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

    return _Stream(
        name=str(info["name"][0]),
        is_text=info["channel_format"][0] == "string",
        labels=tuple(_text(channel, "label") for channel in channels),
        t_s=np.asarray(stream["time_stamps"], dtype=np.float64),
        rows=stream["time_series"],
    )


def _text(channel: Any, key: str) -> str:
    """A text in the header of a channel, empty where it is missing."""
    texts = channel.get(key) or [""]
    return str(texts[0] or "")


def read_log(path: Path, name: str) -> ForeignLog:
    """Any XDF file as a log: a stream with columns `stream.channel`; of markers, one of texts.

    Raises DataNotFound, NotANumber or TimeError.
    """
    streams = []
    for stream in _loaded(path):
        if not len(stream.t_s):
            continue
        if not (np.abs(stream.t_s) < LATEST_S).all():
            raise TimeError(f"stamps of {stream.name:.60} are no times", where=path)
        columns: Columns = {}
        if stream.is_text:
            texts = [str(row[0]) if len(row) else "" for row in stream.rows]
            columns[stream.name] = np.array(texts, dtype=object)
        else:
            values = np.asarray(stream.rows, dtype=np.float64)
            for k, label in enumerate(stream.labels):
                columns[f"{stream.name}.{label or k}"] = values[:, k]
        t_ns = np.round(stream.t_s * 1e9).astype(np.int64)
        streams.append(Stream(columns, t_ns))
    return ForeignLog(path, name, tuple(streams))
