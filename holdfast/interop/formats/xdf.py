"""XDF recordings (such as LabRecorder's) as logs, for `holdfast import`.

This module alone imports pyxdf. Clocks are those of the recorder: pyxdf corrects the stamps of each
stream by the clock offsets in the file, also where a sender's clock was set anew. Its removal of
jitter is off, because a straight line through all stamps hides lost samples.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.errors import needs_extra
from holdfast.interop.formats.streams import Columns, ForeignLog, Stream, text_column

with needs_extra("xdf"):
    import pyxdf


def read_log(path: Path, name: str) -> ForeignLog:
    """Any XDF file, also compressed, as a log: a stream with columns `stream.channel`.

    A stream of markers has one column of texts.
    """
    loaded = pyxdf.load_xdf(path, dejitter_timestamps=False)[0]
    streams = [_stream(one) for one in loaded if len(one["time_stamps"])]
    return ForeignLog(path, name, tuple(streams))


def _stream(loaded: Any) -> Stream:
    """A stream of pyxdf as columns."""
    info, rows = loaded["info"], loaded["time_series"]
    name = info["name"][0]
    columns: Columns = {}
    if info["channel_format"][0] == "string":
        columns[name] = text_column([row[0] for row in rows])
    else:
        values = np.asarray(rows, dtype=np.float64)
        labels = _labels(info, values.shape[1])
        for label, channel in zip(labels, values.T, strict=True):
            columns[f"{name}.{label}"] = channel

    t_ns = np.round(1e9 * loaded["time_stamps"]).astype(np.int64)
    return Stream(columns, t_ns, name)


def _labels(info: Any, n_channels: int) -> list[str]:
    """The labels of the channels with their units, numbers where the header has no label for each.

    Every level of an XDF header is a list.
    """
    with suppress(KeyError, IndexError, TypeError):
        channels = info["desc"][0]["channels"][0]["channel"]
        labels = [str(channel["label"][0]) for channel in channels]
        for k, channel in enumerate(channels):
            unit = (channel.get("unit") or [None])[0]
            labels[k] += f" [{unit}]" if unit else ""
        if len(labels) == n_channels:
            return labels

    return [*map(str, range(n_channels))]
