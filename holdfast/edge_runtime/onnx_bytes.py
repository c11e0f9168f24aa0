"""A model file's graph, read from its bytes before onnxruntime sees any of it.

Only what our exporter writes is accepted. Field numbers are those of
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto. A field that the exporter never writes has
no number here and is refused: subgraphs, local functions, external data, sequences, optionals,
sparse tensors, training graphs, text.

The protobuf wire format, read strictly, before any other parser sees a model file's bytes.

https://protobuf.dev/programming-guides/encoding/: a message is a row of fields; a field is a tag
(number * 8 + wire type) and a value. Two parsers can disagree on a message that repeats a singular
field, pads a number or holds unknown fields. So all of these are refused, and an accepted message
has one meaning only. The number of fields is limited; numpy decodes long lists of numbers.
"""

from __future__ import annotations

import math
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
    if (
        (raw[tags] != tag).any()
        or (tags[:1] != 0).any()
        or (tags[1:] != ends[:-1] + 1).any()
    ):
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


def listed_words(
    data: memoryview, tag: int, words: tuple[bytes, bytes]
) -> npt.NDArray[np.bool_]:
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


MODEL: Schema = {
    1: Field("ir_version", VARINT),
    2: Field("producer_name", LENGTH),
    7: Field("graph", LENGTH),
    8: Field("opset_import", LENGTH, repeated=True),
    14: Field("metadata_props", LENGTH, repeated=True),
}
OPSET: Schema = {1: Field("domain", LENGTH), 2: Field("version", VARINT)}
ENTRY: Schema = {1: Field("key", LENGTH), 2: Field("value", LENGTH)}
GRAPH: Schema = {
    1: Field("node", LENGTH, repeated=True),
    2: Field("name", LENGTH),
    5: Field("initializer", LENGTH, repeated=True),
    11: Field("input", LENGTH, repeated=True),
    12: Field("output", LENGTH, repeated=True),
}
NODE: Schema = {
    1: Field("input", LENGTH, repeated=True),
    2: Field("output", LENGTH, repeated=True),
    4: Field("op_type", LENGTH),
    5: Field("attribute", LENGTH, repeated=True),
    7: Field("domain", LENGTH),
}
TENSOR: Schema = {
    1: Field("dims", VARINT, repeated=True),
    2: Field("data_type", VARINT),
    8: Field("name", LENGTH),
    9: Field("raw_data", LENGTH),
}
VALUE: Schema = {1: Field("name", LENGTH), 2: Field("type", LENGTH)}
TYPE: Schema = {1: Field("tensor_type", LENGTH)}
TENSOR_TYPE: Schema = {1: Field("elem_type", VARINT), 2: Field("shape", LENGTH)}
SHAPE: Schema = {1: Field("dim", LENGTH, repeated=True)}
DIMENSION: Schema = {1: Field("dim_value", VARINT), 2: Field("dim_param", LENGTH)}

FLOAT, INT32, INT64, BOOL, DOUBLE = 1, 6, 7, 9, 11
DTYPES: dict[int, str] = {
    FLOAT: "<f4",
    INT32: "<i4",
    INT64: "<i8",
    BOOL: "|b1",
    DOUBLE: "<f8",
}
"""TensorProto.DataType -> the type of its raw data in the file."""
INT, STRING, FLOATS, INTS, STRINGS = 2, 3, 6, 7, 8
"""AttributeProto.AttributeType: the types that our attributes have."""
_TYPE_TAG = b"\xa0\x01"
"""The tag of AttributeProto.type (field 20), which protobuf writes last."""
TREE_MODES = (b"LEAF", b"BRANCH_LEQ")
"""The only list of words in a graph of ours: what each node of a tree is."""
MOST_ELEMENTS = 10_000_000
"""Of one tensor, when a single sample is stepped."""

Value = int | bytes | npt.NDArray[Any]


@dataclass(frozen=True)
class Node:
    """One operator; its attributes by name are whole numbers, words or arrays."""

    domain: str
    op_type: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Value]


@dataclass(frozen=True)
class TensorSpec:
    """An input or output as the file declares it.

    Element type, and dimensions (a word for the batch).
    """

    element: int
    shape: tuple[int | str, ...]


@dataclass(frozen=True)
class OnnxModel:
    """Everything that a model file of ours holds."""

    ir_version: int
    opsets: dict[str, int]
    metadata: dict[str, str]
    nodes: tuple[Node, ...]
    constants: dict[str, npt.NDArray[Any]]
    inputs: dict[str, TensorSpec]
    outputs: dict[str, TensorSpec]


def read_onnx(data: bytes) -> OnnxModel:
    """The model in the bytes.

    Raises ValueError, in plain words, for what our exporter never writes.
    """
    reader = Reader()
    model = reader.message(memoryview(data), MODEL)
    graph = reader.message(_one(model, "graph"), GRAPH)
    tensors = [
        _tensor(reader.message(one, TENSOR)) for one in graph.get("initializer", ())
    ]
    return OnnxModel(
        ir_version=_one(model, "ir_version"),
        opsets=_unique(
            [
                _opset(reader.message(one, OPSET))
                for one in model.get("opset_import", ())
            ]
        ),
        metadata=_unique(
            [
                _entry(reader.message(one, ENTRY))
                for one in model.get("metadata_props", ())
            ]
        ),
        nodes=tuple(_node(reader, one) for one in graph.get("node", ())),
        constants=_unique(tensors),
        inputs=_unique([_declared(reader, one) for one in graph.get("input", ())]),
        outputs=_unique([_declared(reader, one) for one in graph.get("output", ())]),
    )


def _one(message: Message, name: str) -> Any:
    if name not in message:
        raise ValueError(f"it lacks the field {name}")
    return message[name][0]


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name occurs twice in it")
    return found


def _opset(message: Message) -> tuple[str, int]:
    return text(message.get("domain", [memoryview(b"")])[0]), _one(message, "version")


def _entry(message: Message) -> tuple[str, str]:
    return text(_one(message, "key")), bytes(_one(message, "value")).decode("utf-8")


def _node(reader: Reader, data: memoryview) -> Node:
    message = reader.message(data, NODE)
    op_type = text(_one(message, "op_type"))
    try:
        attributes = _unique([_attribute(one) for one in message.get("attribute", ())])
    except ValueError as error:
        raise ValueError(f"operator {op_type}: {error}") from None
    return Node(
        domain=text(message.get("domain", [memoryview(b"")])[0]),
        op_type=op_type,
        inputs=tuple(text(name) for name in message.get("input", ())),
        outputs=tuple(text(name) for name in message.get("output", ())),
        attributes=attributes,
    )


def _attribute(data: memoryview) -> tuple[str, Value]:
    """Name first, value, type last.

    The order in which protobuf libraries write an AttributeProto.
    """
    if bytes(data[:1]) != b"\x0a" or bytes(data[-3:-1]) != _TYPE_TAG:
        raise ValueError("an attribute is not written as holdfast export writes it")
    length, at = varint(data, 1)
    name, value = data[at : at + length], data[at + length : -3]
    if at + length > len(data) - 3:
        raise ValueError("an attribute is cut short")
    return text(name), _attribute_value(value, data[-1])


def _attribute_value(data: memoryview, kind: int) -> Value:
    if kind == INTS:
        return listed_ints(data, 0x40)
    if kind == FLOATS:
        return listed_floats(data, 0x3D)
    if kind == STRINGS:
        return listed_words(data, 0x4A, TREE_MODES)
    if kind not in (INT, STRING):
        raise ValueError(
            f"an attribute has a type ({kind}) that holdfast export never writes"
        )
    name = "i" if kind == INT else "s"
    message = Reader().message(
        data, {3: Field("i", VARINT)} if kind == INT else {4: Field("s", LENGTH)}
    )
    value = _one(message, name)
    return _signed(value) if kind == INT else bytes(value)


def _signed(value: int) -> int:
    """protobuf writes a negative int64 as its two's complement."""
    return value - (1 << 64) if value >> 63 else value


def _tensor(message: Message) -> tuple[str, npt.NDArray[Any]]:
    """A constant; its dimensions and its raw data must have the same size."""
    dtype = DTYPES.get(_one(message, "data_type"))
    shape = tuple(message.get("dims", ()))
    raw = message.get("raw_data", [memoryview(b"")])[0]
    if dtype is None:
        raise ValueError("a constant has a type that holdfast export never writes")
    if (
        math.prod(shape) > MOST_ELEMENTS
        or math.prod(shape) * np.dtype(dtype).itemsize != len(raw)
        or not len(raw)
    ):
        raise ValueError("a constant has another size than it claims")
    values = np.frombuffer(raw, dtype).reshape(shape)
    if np.isnan(values).any() or (
        values.dtype == np.float32 and not np.isfinite(values).all()
    ):
        raise ValueError("a constant is not finite")
    return text(_one(message, "name")), values


def _declared(reader: Reader, data: memoryview) -> tuple[str, TensorSpec]:
    value = reader.message(data, VALUE)
    tensor = reader.message(
        _one(reader.message(_one(value, "type"), TYPE), "tensor_type"), TENSOR_TYPE
    )
    if "shape" not in tensor:
        raise ValueError("an input or output has no shape")
    dims = reader.message(_one(tensor, "shape"), SHAPE).get("dim", ())
    shape = tuple(_dimension(reader.message(one, DIMENSION)) for one in dims)
    return text(_one(value, "name")), TensorSpec(_one(tensor, "elem_type"), shape)


def _dimension(message: Message) -> int | str:
    if len(message) != 1:
        raise ValueError("a dimension of an input or output is missing")
    if "dim_param" in message:
        return text(message["dim_param"][0])
    return int(message["dim_value"][0])
