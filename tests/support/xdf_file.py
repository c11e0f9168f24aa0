"""XDF files, written byte by byte as the specification of the format (XDF 1.0) has them."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

import numpy as np


def xdf_bytes(chunks: Iterable[bytes]) -> bytes:
    """The magic code, a file header, and chunks."""
    header = b"<?xml version='1.0'?><info><version>1.0</version></info>"
    return b"XDF:" + _chunk(1, header) + b"".join(chunks)


def _chunk(tag: int, content: bytes) -> bytes:
    return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content


def stream_header(
    number: int,
    name: str,
    form: str,
    n_channels: int,
    rate_hz: float,
    channels: str = "",
) -> bytes:
    """Tag 2. channels: XML of the channels' description."""
    xml = (
        f"<?xml version='1.0'?><info><name>{name}</name><type>test</type>"
        f"<channel_count>{n_channels}</channel_count><nominal_srate>{rate_hz}</nominal_srate>"
        f"<channel_format>{form}</channel_format><created_at>0</created_at>"
        f"<desc><channels>{channels}</channels></desc></info>"
    )
    return _chunk(2, struct.pack("<I", number) + xml.encode())


def samples(number: int, t_s: Iterable[float], values: np.ndarray) -> bytes:
    """Tag 3, double64, every sample with its stamp."""
    stamped = [
        b"\x08" + struct.pack("<d", t) + np.asarray(row, dtype="<f8").tobytes()
        for t, row in zip(t_s, values, strict=True)
    ]
    return _chunk(3, struct.pack("<IBI", number, 4, len(stamped)) + b"".join(stamped))


def markers(number: int, texts: Sequence[tuple[float, str]]) -> bytes:
    """Tag 3 of a stream of one text."""
    body = b"".join(
        b"\x08" + struct.pack("<dB", t, 1) + bytes([len(text)]) + text.encode()
        for t, text in texts
    )
    return _chunk(3, struct.pack("<IBI", number, 4, len(texts)) + body)


def clock_offsets(number: int, collected_s: Sequence[float], offset_s: float) -> bytes:
    """Tag 4: to add to the stream's stamps to get the recorder's clock."""
    return b"".join(
        _chunk(4, struct.pack("<Idd", number, t, offset_s)) for t in collected_s
    )
