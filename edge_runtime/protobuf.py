"""The protobuf wire format, read strictly, before any other parser sees a model file's bytes.

https://protobuf.dev/programming-guides/encoding/: a message is a row of fields; a field is a tag
(number * 8 + wire type) and a value. Two parsers can disagree on a message that repeats a singular
field, pads a number or holds unknown fields. So all of these are refused, and an accepted message
has one meaning only. The number of fields is limited; numpy decodes long lists of numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

VARINT, LENGTH = 0, 2
"""Wire types in our model files: a number, and data preceded by its length in bytes."""
MOST_FIELDS = 100_000
"""In a whole file. The default model has 1,300; numbers in lists are not counted."""
LONGEST_VARINT, LONGEST_LISTED = 10, 5
"""Bytes of one number, and of a number in a list (of trees, nodes or features)."""

IntArray = npt.NDArray[np.int64]
Message = dict[str, list[Any]]


@dataclass(frozen=True)
class Field:
    """A field that a message may have: its name, its wire type, and whether it may be repeated."""

    name: str
    wire: int
    repeated: bool = False


Schema = Mapping[int, Field]


class Reader:
    """Reads messages; `fields` counts the fields of all of them."""

    def __init__(self) -> None:
        self.fields = 0

    def message(self, data: memoryview, schema: Schema) -> Message:
        """Name -> values (int or memoryview). Raises ValueError for fields outside the schema."""
        found: Message = {}
        at = 0
        while at < len(data):
            tag, at = varint(data, at)
            field = self._field(tag, schema)
            value, at = _value(data, at, field.wire)
            values = found.setdefault(field.name, [])
            if values and not field.repeated:
                raise ValueError(f"its field {field.name} occurs twice")
            values.append(value)
        return found

    def _field(self, tag: int, schema: Schema) -> Field:
        self.fields += 1
        if self.fields > MOST_FIELDS:
            raise ValueError(f"it has more than {MOST_FIELDS} fields")
        field = schema.get(tag >> 3)
        if field is None or field.wire != tag & 7:
            number, wire = tag >> 3, tag & 7
            raise ValueError(
                f"it has a field (number {number}, type {wire}) that holdfast export never writes"
            )
        return field


def _value(data: memoryview, at: int, wire: int) -> tuple[int | memoryview, int]:
    number, at = varint(data, at)
    if wire == VARINT:
        return number, at
    if number > len(data) - at:
        raise ValueError("a field is longer than its message")
    return data[at : at + number], at + number


def varint(data: memoryview, at: int) -> tuple[int, int]:
    """The number that begins at `at`, and where the next field begins. Raises ValueError."""
    value = 0
    for k, byte in enumerate(data[at : at + LONGEST_VARINT]):
        value |= (byte & 0x7F) << (7 * k)
        if byte < 0x80:
            if (k and not byte) or value >= 1 << 64:
                break
            return value, at + k + 1
    raise ValueError("a number in it is cut short, padded or too long")


def text(data: memoryview) -> str:
    """Names and words of a graph are ASCII; ValueError."""
    return bytes(data).decode("ascii")


def listed_ints(data: memoryview, tag: int) -> IntArray:
    """A list of whole numbers from 0, each behind its tag (as protobuf 2 writes lists).

    Raises ValueError.
    """
    raw = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(raw < 0x80)
    if len(ends) % 2 or (len(raw) and (not len(ends) or ends[-1] != len(raw) - 1)):
        raise ValueError("a list of numbers is cut short")
    tags, ends = ends[::2], ends[1::2]
    if (raw[tags] != tag).any() or (tags[:1] != 0).any() or (tags[1:] != ends[:-1] + 1).any():
        raise ValueError("a list of numbers holds other data")
    return _joined(raw, ends, ends - tags)


def _joined(raw: npt.NDArray[np.uint8], ends: IntArray, lengths: IntArray) -> IntArray:
    """Seven bits a byte, the lowest first; the highest is not 0."""
    values = raw[ends].astype(np.int64)
    longer = np.flatnonzero(lengths > 1)
    if (lengths > LONGEST_LISTED).any() or (values[longer] == 0).any():
        raise ValueError("a number in a list is padded or too large")
    for back in range(1, LONGEST_LISTED):
        values[longer] = values[longer] << 7 | (raw[ends[longer] - back] & 0x7F)
        longer = longer[lengths[longer] > back + 1]
    return values


def listed_floats(data: memoryview, tag: int) -> npt.NDArray[np.float32]:
    """A list of float32, each behind its tag; ValueError."""
    if len(data) % 5:
        raise ValueError("a list of numbers is cut short")
    raw = np.frombuffer(data, np.uint8).reshape(-1, 5)
    if (raw[:, 0] != tag).any():
        raise ValueError("a list of numbers holds other data")
    return np.ascontiguousarray(raw[:, 1:]).view("<f4").ravel()


def listed_words(data: memoryview, tag: int, words: tuple[bytes, bytes]) -> npt.NDArray[np.bool_]:
    """Which entries of a list of two words are the second one; each is behind its tag and length.

    The tag occurs in neither word, so two entries never overlap, and counting them is parsing.
    Raises ValueError.
    """
    entries = [bytes([tag, len(word)]) + word for word in words]
    whole = bytes(data)
    if sum(whole.count(entry) * len(entry) for entry in entries) != len(whole):
        allowed = " and ".join(word.decode() for word in words)
        raise ValueError(f"a list of words holds other words than {allowed}")
    raw = np.frombuffer(whole, np.uint8)
    second: npt.NDArray[np.bool_] = raw[np.flatnonzero(raw == tag) + 1] == len(words[1])
    return second
