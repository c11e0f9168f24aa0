"""A model file's graph, read from its bytes before onnxruntime sees any of it.

Only what our exporter writes is accepted: its operators (ALLOWED), and the fields of
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto that it uses. A field that it never writes
has no number here and is refused: subgraphs, local functions, external data, sequences, optionals,
sparse tensors, training graphs, text.

The wire format (https://protobuf.dev/programming-guides/encoding/) is read strictly. A message is a
row of fields; a field is a tag (number * 8 + wire type) and a value. Two parsers can disagree on a
message that repeats a singular field, pads a number or holds unknown fields. So all of these are
refused, and an accepted message has one meaning only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

VARINT = 0
"""Wire type of a number."""
LENGTH = 2
"""Wire type of data preceded by their length in bytes. Our model files have no other."""
MOST_FIELDS = 100_000
"""In a whole file. The default model has 1,300; numbers in lists are not counted."""
LONGEST_VARINT = 10
"""Bytes of one number."""
MOST_ELEMENTS = 10_000_000
"""Of one constant."""

IR_VERSION = 10
OPSETS = {"": 20, "ai.onnx.ml": 3}
ALLOWED = frozenset(
    (
        "Abs",
        "Add",
        "And",
        "ArgMax",
        "Cast",
        "Clip",
        "Concat",
        "Div",
        "Flatten",
        "Floor",
        "Gather",
        "Greater",
        "GreaterOrEqual",
        "Less",
        "MatMul",
        "Max",
        "Min",
        "Mul",
        "ReduceL2",
        "ReduceMax",
        "ReduceMin",
        "ReduceSum",
        "Reshape",
        "Round",
        "Slice",
        "Softmax",
        "Split",
        "Sqrt",
        "Sub",
        "Transpose",
        "Where",
        "ai.onnx.ml.TreeEnsembleRegressor",
    )
)
"""All operators that export/ writes, with any options; those of another domain with its name."""

Message = dict[str, list[Any]]


@dataclass(frozen=True)
class Field:
    """A field that a message may have: its name, and whether it may be repeated.

    inside: the fields of a message in it; None for plain bytes, or for a number.
    """

    name: str
    repeated: bool = False
    inside: Mapping[int, Field] | None = None
    wire: int = LENGTH


Schema = Mapping[int, Field]

DIMENSION: Schema = {1: Field("dim_value", wire=VARINT), 2: Field("dim_param")}
SHAPE: Schema = {1: Field("dim", True, DIMENSION)}
TENSOR_TYPE: Schema = {
    1: Field("elem_type", wire=VARINT),
    2: Field("shape", inside=SHAPE),
}
TYPE: Schema = {1: Field("tensor_type", inside=TENSOR_TYPE)}
VALUE: Schema = {1: Field("name"), 2: Field("type", inside=TYPE)}
TENSOR: Schema = {
    1: Field("dims", True, wire=VARINT),
    2: Field("data_type", wire=VARINT),
    8: Field("name"),
    9: Field("raw_data"),
}
ATTRIBUTE: Schema = {3: Field("i", wire=VARINT), 4: Field("s")}
NODE: Schema = {
    1: Field("input", True),
    2: Field("output", True),
    4: Field("op_type"),
    5: Field("attribute", True),
    7: Field("domain"),
}
GRAPH: Schema = {
    1: Field("node", True, NODE),
    2: Field("name"),
    5: Field("initializer", True, TENSOR),
    11: Field("input", True, VALUE),
    12: Field("output", True, VALUE),
}
OPSET: Schema = {1: Field("domain"), 2: Field("version", wire=VARINT)}
ENTRY: Schema = {1: Field("key"), 2: Field("value")}
MODEL: Schema = {
    1: Field("ir_version", wire=VARINT),
    2: Field("producer_name"),
    7: Field("graph", inside=GRAPH),
    8: Field("opset_import", True, OPSET),
    14: Field("metadata_props", True, ENTRY),
}

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
"""AttributeProto.AttributeType: the types that our attributes have; none of them is a graph."""
_NAME_TAG = b"\x0a"
"""The tag of an attribute's name: field 1, data with a length."""
_TYPE_TAG = b"\xa0\x01"
"""The tag of an attribute's type: field 20, a number, in two bytes."""


@dataclass(frozen=True)
class Node:
    """One operator; its attributes by name.

    A whole number or a word is decoded. A list stays in bytes, each entry behind its tag: nothing
    that runs on the hand needs it, and export/c/graph.py decodes it.
    """

    domain: str
    op_type: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]


@dataclass(frozen=True)
class TensorSpec:
    """An input or output as the file declares it.

    element: of TensorProto.DataType. shape: dimensions, a word for the batch.
    """

    element: int
    shape: tuple[int | str, ...]


@dataclass(frozen=True)
class OnnxModel:
    """Everything that a model file of ours holds."""

    metadata: dict[str, str]
    nodes: tuple[Node, ...]
    constants: dict[str, npt.NDArray[Any]]
    inputs: dict[str, TensorSpec]
    outputs: dict[str, TensorSpec]


def read_onnx(data: bytes) -> OnnxModel:
    """The model in the bytes.

    Raises ValueError, in plain words, for what our exporter never writes.
    """
    model = Reader().message(memoryview(data), MODEL)
    opsets = {}
    for opset in model.get("opset_import", []):
        # the standard operators have an empty domain, which protobuf leaves out
        domain = _text(_only(opset, "domain", b""))
        opsets[domain] = _only(opset, "version")

    if _only(model, "ir_version") != IR_VERSION or opsets != OPSETS:
        raise ValueError(f"it has other operator sets ({opsets!s:.80})")

    metadata = []
    for entry in model.get("metadata_props", []):
        key = _text(_only(entry, "key"))
        value = bytes(_only(entry, "value")).decode("utf-8")
        metadata.append((key, value))

    graph = _only(model, "graph")
    return OnnxModel(
        metadata=_unique(metadata),
        nodes=tuple(map(_node, graph.get("node", []))),
        constants=_unique([_constant(one) for one in graph.get("initializer", [])]),
        inputs=_unique([_declared(one) for one in graph.get("input", [])]),
        outputs=_unique([_declared(one) for one in graph.get("output", [])]),
    )


class Reader:
    """Reads messages; `fields` counts the fields of all of them."""

    def __init__(self) -> None:
        self.fields = 0

    def message(self, data: memoryview, schema: Schema) -> Message:
        """Name -> values (int, memoryview or Message).

        Raises ValueError for fields outside the schema.
        """
        found: Message = {}
        at = 0
        while at < len(data):
            tag, at = _varint(data, at)
            field = self._field(tag, schema)
            value: Any
            value, at = _varint(data, at)
            if field.wire == LENGTH:
                # the number is a length: what follows it is the value
                end = at + value
                if end > len(data):
                    raise ValueError("a field is longer than its message")
                value = data[at:end]
                at = end

            if field.inside is not None:
                value = self.message(value, field.inside)
            values = found.setdefault(field.name, [])
            if values and not field.repeated:
                raise ValueError(f"its field {field.name} occurs twice")
            values.append(value)

        return found

    def _field(self, tag: int, schema: Schema) -> Field:
        """What the schema says of a tag. Raises ValueError."""
        self.fields += 1
        if self.fields > MOST_FIELDS:
            raise ValueError(f"it has more than {MOST_FIELDS} fields")

        number = tag >> 3
        wire = tag & 7
        field = schema.get(number)
        if field is None or field.wire != wire:
            raise ValueError(
                f"it has a field (number {number}, type {wire}) that holdfast export never writes"
            )

        return field


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """The number that begins at `at`, and where the next field begins. Raises ValueError."""
    value = 0
    for k, byte in enumerate(data[at : at + LONGEST_VARINT]):
        # seven bits a byte, the lowest first; the eighth says that another byte follows
        value |= (byte & 0x7F) << (7 * k)
        if byte < 0x80:
            # a last byte of 0 pads the number; more than 64 bits is no number
            if (k and not byte) or value >= 1 << 64:
                break
            return value, at + k + 1

    raise ValueError("a number in it is cut short, padded or too long")


def _text(data: memoryview | bytes) -> str:
    """Names of a graph are ASCII; ValueError."""
    return bytes(data).decode("ascii")


def _only(message: Message, name: str, default: Any = None) -> Any:
    """The value of a field that occurs once. Raises ValueError where it is missing."""
    if name in message:
        return message[name][0]
    if default is None:
        raise ValueError(f"it lacks the field {name}")
    return default


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A dictionary of pairs. Raises ValueError for a name that occurs twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name occurs twice in it")
    return found


def _node(message: Message) -> Node:
    """One operator. Raises ValueError for one that our exporter never writes."""
    domain = _text(_only(message, "domain", b""))
    op_type = _text(_only(message, "op_type"))
    name = f"{domain}.{op_type}" if domain else op_type
    if name not in ALLOWED:
        raise ValueError(
            f"it has the operator {name}, which holdfast export never writes"
        )

    return Node(
        domain=domain,
        op_type=op_type,
        inputs=tuple(map(_text, message.get("input", []))),
        outputs=tuple(map(_text, message.get("output", []))),
        attributes=_unique([_attribute(one) for one in message.get("attribute", [])]),
    )


def _attribute(data: memoryview) -> tuple[str, Any]:
    """(name, value): protobuf libraries write the name first, the value next, the type last.

    It is not read field by field: a forest's lists have a million entries.
    """
    first = bytes(data[:1])
    last = bytes(data[-3:-1])
    if first != _NAME_TAG or last != _TYPE_TAG:
        raise ValueError("an attribute is not written as holdfast export writes it")

    # the last three bytes are the tag and the number of the type
    length, at = _varint(data, 1)
    if at + length > len(data) - 3:
        raise ValueError("an attribute is cut short")

    name = data[at : at + length]
    value = data[at + length : -3]
    kind = data[-1]
    if kind not in (INT, STRING, INTS, FLOATS, STRINGS):
        raise ValueError(
            f"an attribute has a type ({kind}) that holdfast export never writes"
        )

    reader = Reader()
    if kind == INT:
        number = _only(reader.message(value, ATTRIBUTE), "i")
        # protobuf writes a negative int64 as its two's complement
        if number >> 63:
            number -= 1 << 64
        return _text(name), number
    if kind == STRING:
        word = _only(reader.message(value, ATTRIBUTE), "s")
        return _text(name), bytes(word)

    return _text(name), bytes(value)


def _constant(message: Message) -> tuple[str, npt.NDArray[Any]]:
    """(name, values); the dimensions must have the size of the raw data."""
    dtype = DTYPES.get(_only(message, "data_type"))
    if dtype is None:
        raise ValueError("a constant has a type that holdfast export never writes")

    shape = tuple(message.get("dims", []))
    raw = _only(message, "raw_data", b"")
    size = math.prod(shape)

    # compared before numpy multiplies: a claimed shape may overflow its integers
    n_bytes = size * np.dtype(dtype).itemsize
    if not 0 < size <= MOST_ELEMENTS or n_bytes != len(raw):
        raise ValueError("a constant has another size than it claims")

    values = np.frombuffer(raw, dtype).reshape(shape)
    return _text(_only(message, "name")), values


def _declared(message: Message) -> tuple[str, TensorSpec]:
    """(name, type and shape) of an input or output."""
    tensor = _only(_only(message, "type"), "tensor_type")
    shape: list[int | str] = []
    for dimension in _only(tensor, "shape").get("dim", []):
        # a size, or a word for the batch, but not both and not neither
        if len(dimension) != 1:
            raise ValueError("a dimension of an input or output is missing")
        if "dim_param" in dimension:
            shape.append(_text(_only(dimension, "dim_param")))
        else:
            shape.append(_only(dimension, "dim_value"))

    spec = TensorSpec(_only(tensor, "elem_type"), tuple(shape))
    return _text(_only(message, "name")), spec
