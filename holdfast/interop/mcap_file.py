"""Trials as MCAP files for Foxglove: `<name>.mcap`.

| topic | schema | messages |
| --- | --- | --- |
| /tactile/arrows | foxglove.SceneUpdate (protobuf) | a sample; an arrow a valid finger, a text |
| /tactile/fingers | holdfast.Fingers (JSON) | a sample; a lost value is null |
| /situation | holdfast.Situation (JSON) | each change of the label |
| /log | foxglove.Log (protobuf) | marks, changes of the label, fingers lost and back |
| /tf | foxglove.FrameTransform (protobuf) | one: the frame of the arrows |

The 3D view is a picture, not the geometry of a hand: two rows of pads face each other, the thumb's
and that of the other fingers, and each arrow points from its pad away from the object. This module
alone imports mcap, mcap_protobuf and foxglove_schemas_protobuf. `read_log` reads any file whose
messages are JSON, protobuf or those of ROS 2: each number is a column `topic.field`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from holdfast.core.contract import AXES, FloatArray, Json, Unit
from holdfast.core.errors import DataError, NotANumber, needs_extra
from holdfast.core.hand_card import hand_of_counts
from holdfast.core.schema import json_of
from holdfast.interop.logs.log import ForeignLog, Stream, columns_of
from holdfast.interop.payload import TrialPayload, log_lines

HALF_GAP_M = 0.03
"""From the middle of the object to each row."""
ONE_ROW_M = 0.022
"""Between two pads of a hand without six sensors, which are one row."""
METRES_PER_UNIT = MappingProxyType({"N": 1e-2, "uT": 1e-5, "count": 1e-5})
"""Length of an arrow: 1 N is 1 cm long, and so is 1000 uT, about the field of 1 N."""


@dataclass(frozen=True)
class Pads:
    """at_m [S, 3] places; turned [S, 3, 3] from a sensor's axes to those of the view."""

    at_m: FloatArray
    turned: FloatArray


def pads(n_sensors: int) -> Pads:
    """The pads of a hand in the order of its channels (docs/wiring.md)."""
    hand = hand_of_counts()
    if n_sensors == hand.n_contacts:
        along = hand.along_m
        is_thumb = np.arange(n_sensors) < hand.thumb
        side = np.where(is_thumb, -1.0, 1.0)
    else:
        # Of other hands only the number of sensors is known: one row, its middle at zero.
        numbers = np.arange(n_sensors, dtype=np.float64)
        along = ONE_ROW_M * (0.5 * (n_sensors - 1) - numbers)
        side = np.ones(n_sensors)

    at_m = np.column_stack([along, HALF_GAP_M * side, np.zeros(n_sensors)])
    turned = np.zeros((n_sensors, 3, 3))
    turned[:, 0, 0] = 1.0  # a sensor's X along the row
    turned[:, 1, 2] = side  # its Z, the normal, away from the object
    turned[:, 2, 1] = -side  # its Y completes a right-handed frame
    return Pads(at_m, turned)


def orientations(along: FloatArray) -> FloatArray:
    """[n, 4] quaternions x, y, z, w that turn the x axis to unit vectors [n, 3].

    The half-way quaternion (1 + x . v, x cross v), normalised; opposite to x it turns about z.

    >>> orientations(np.array([[0.0, 0.0, 1.0]])).round(4).tolist()
    [[0.0, -0.7071, 0.0, 0.7071]]
    """
    zero = np.zeros(len(along))
    halfway = np.column_stack([zero, -along[:, 2], along[:, 1], 1.0 + along[:, 0]])

    # Opposite to x the half-way quaternion is zero: any half turn about a normal to x will do.
    is_opposite = np.linalg.norm(halfway, axis=1) < 1e-9
    halfway[is_opposite] = (0.0, 0.0, 1.0, 0.0)
    unit: FloatArray = halfway / np.linalg.norm(halfway, axis=1, keepdims=True)
    return unit


def arrows(
    values: FloatArray, unit: Unit, where: Pads
) -> tuple[FloatArray, FloatArray]:
    """(length [S] in m, quaternion [S, 4]) of the arrows of a sample, values [C] all finite."""
    by_sensor = values.reshape(-1, 3)

    # Each pad has axes of its own, so its reading is turned into the axes of the view.
    vectors = np.einsum("sij,sj->si", where.turned, by_sensor)

    size = np.linalg.norm(vectors, axis=1, keepdims=True)

    # An arrow of no length has no direction; it points along x.
    towards = np.tile([1.0, 0.0, 0.0], (len(size), 1))
    np.divide(vectors, size, where=size > 0.0, out=towards)
    return METRES_PER_UNIT[unit] * size[:, 0], orientations(towards)


with needs_extra("mcap"):
    from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
    from foxglove_schemas_protobuf.Color_pb2 import Color
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from foxglove_schemas_protobuf.Pose_pb2 import Pose
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
    from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
    from google.protobuf.json_format import MessageToDict
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap.reader import make_reader
    from mcap.writer import Writer
    from mcap_protobuf.decoder import DecoderFactory
    from mcap_protobuf.schema import register_schema

ROOT_FRAME, FRAME = "world", "hand"
UPRIGHT = Quaternion(w=1.0)
ABOVE = Pose(position=Vector3(z=0.08), orientation=UPRIGHT)
"""Where the text stands: 8 cm above the middle of the object."""
PAD_SIZE = Vector3(x=0.012, y=0.012, z=0.012)
"""Diameter of a pad on all three axes, m: 12 mm."""
SHAFT_M = 0.004
"""Diameter of an arrow's shaft, m; its head is twice as wide."""
HEAD_M = 0.008
"""Length of an arrow's head, m."""
TEXT_M = 0.012
"""Height of the text, m."""
PAD = Color(r=0.55, g=0.58, b=0.62, a=0.9)
LOST = Color(r=0.1, g=0.1, b=0.1, a=0.3)
ARROW = Color(r=0.13, g=0.35, b=0.6, a=1.0)
INK = Color(r=0.12, g=0.16, b=0.2, a=1.0)
"""No colour of a situation: a finger has none."""
NUMBER = {"type": ["number", "null"]}
FINGER = {
    "type": "object",
    "properties": {**dict.fromkeys(AXES, NUMBER), "valid": {"type": "boolean"}},
}
SCHEMAS: dict[str, Json] = {
    "holdfast.Fingers": {
        "type": "object",
        "properties": {
            "unit": {"type": "string"},
            "fingers": {"type": "array", "items": FINGER},
        },
    },
    "holdfast.Situation": {
        "type": "object",
        "properties": {
            "situation": {"type": "string"},
            "by": {"type": "string"},
            "t0_s": {"type": "number"},
            "t1_s": {"type": "number"},
        },
    },
}


def write_trials(trials: Iterable[TrialPayload], folder: Path) -> None:
    """One file for each trial below a folder."""
    for trial in trials:
        path = folder / f"{trial.name}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        # The metadata of MCAP are texts, so each value is JSON of its own.
        about = {key: json.dumps(value) for key, value in trial.about.items()}

        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(library="holdfast")
            _write(_Topics(writer), trial)
            writer.add_metadata("holdfast", about)
            writer.finish()


@dataclass
class _Topics:
    """A writer whose topics appear with their first message."""

    writer: Writer
    _channels: dict[str, int] = field(default_factory=dict)

    def proto(self, topic: str, t_ns: int, message: Any) -> None:
        """Write a protobuf message."""
        if topic not in self._channels:
            schema = register_schema(self.writer, type(message))
            self._register(topic, "protobuf", schema)
        self._add(topic, t_ns, message.SerializeToString())

    def json(self, topic: str, t_ns: int, schema: str, message: Json) -> None:
        """Write a JSON message of a schema in SCHEMAS."""
        if topic not in self._channels:
            # Foxglove names a JSON schema by its title.
            text = json.dumps({"title": schema, **SCHEMAS[schema]})

            number = self.writer.register_schema(schema, "jsonschema", text.encode())
            self._register(topic, "json", number)
        # allow_nan=False: the browser's JSON parser refuses a bare NaN.
        text = json.dumps(message, allow_nan=False)
        self._add(topic, t_ns, text.encode())

    def _register(self, topic: str, encoding: str, schema: int) -> None:
        """Make a channel for a topic and remember its number."""
        number = self.writer.register_channel(topic, encoding, schema)
        self._channels[topic] = number

    def _add(self, topic: str, t_ns: int, data: bytes) -> None:
        """Write a message that is encoded already, at its own time."""
        channel = self._channels[topic]
        self.writer.add_message(channel, log_time=t_ns, data=data, publish_time=t_ns)


def _write(topics: _Topics, trial: TrialPayload) -> None:
    """All messages of a trial: the frame, the log, situations, then sample by sample."""
    stamps = trial.t_ns.tolist()
    # The 3D view draws an entity only if its frame is known from a transform.
    frame = FrameTransform(
        timestamp=_stamp(stamps[0]),
        parent_frame_id=ROOT_FRAME,
        child_frame_id=FRAME,
        rotation=UPRIGHT,
    )
    topics.proto("/tf", stamps[0], frame)

    for line in log_lines(trial):
        message = Log(
            timestamp=_stamp(line.t_ns),
            level=Log.WARNING if line.is_loss else Log.INFO,
            message=line.text,
            name="holdfast",
        )
        topics.proto("/log", line.t_ns, message)

    for first, stop, name in trial.phases():
        situation = {
            "situation": name,
            "by": trial.about["labels_by"],
            "t0_s": float(trial.t_s[first]),
            "t1_s": float(trial.t_s[stop - 1]),
        }
        topics.json("/situation", stamps[first], "holdfast.Situation", situation)

    where = pads(trial.n_sensors)
    for row, name in enumerate(trial.situations()):
        t_ns = stamps[row]

        entity = _hand(trial, row, t_ns, where)
        entity.texts.append(_text(name))
        topics.proto("/tactile/arrows", t_ns, SceneUpdate(entities=[entity]))
        fingers = {"unit": trial.unit, "fingers": _fingers(trial, row)}
        topics.json("/tactile/fingers", t_ns, "holdfast.Fingers", fingers)


def _fingers(trial: TrialPayload, row: int) -> list[Json]:
    """The readings of a sample; JSON has no nan, so a lost value is None."""
    fingers: list[Json] = []

    readings = trial.values[row].reshape(-1, len(AXES)).tolist()
    are_valid = trial.valid[row].tolist()

    for reading, valid in zip(readings, are_valid, strict=True):
        finger: Json = {"valid": valid}
        for axis, value in zip(AXES, reading, strict=True):
            finger[axis] = value if np.isfinite(value) else None
        fingers.append(finger)
    return fingers


def _hand(trial: TrialPayload, row: int, t_ns: int, where: Pads) -> Any:
    """All pads, and the arrows of those that were measured."""
    # Lost values become zero only to keep the arithmetic finite: their arrows are not drawn.
    values = np.nan_to_num(trial.values[row], nan=0.0, posinf=0.0, neginf=0.0)
    lengths_m, turns = arrows(values, trial.unit, where)

    # One id for all samples: each message replaces the hand that was drawn before.
    entity = SceneEntity(timestamp=_stamp(t_ns), frame_id=FRAME, id="hand")
    for sensor, (x, y, z) in enumerate(where.at_m.tolist()):
        at = Vector3(x=x, y=y, z=z)
        valid = bool(trial.valid[row, sensor])
        pad = SpherePrimitive(
            pose=Pose(position=at, orientation=UPRIGHT),
            size=PAD_SIZE,
            color=PAD if valid else LOST,
        )
        entity.spheres.append(pad)
        if valid:
            length_m = float(lengths_m[sensor])
            entity.arrows.append(_arrow(at, length_m, turns[sensor].tolist()))
    return entity


def _arrow(at: Any, length_m: float, turn: list[float]) -> Any:
    """An arrow from a place; turn: the quaternion x, y, z, w."""
    x, y, z, w = turn
    # A short arrow is all head, so that its length still shows the force.
    head_m = min(HEAD_M, length_m)

    pose = Pose(position=at, orientation=Quaternion(x=x, y=y, z=z, w=w))
    return ArrowPrimitive(
        pose=pose,
        shaft_length=length_m - head_m,
        shaft_diameter=SHAFT_M,
        head_length=head_m,
        head_diameter=2 * SHAFT_M,
        color=ARROW,
    )


def _text(name: str) -> Any:
    """The situation above the hand, turned to the viewer."""
    return TextPrimitive(
        pose=ABOVE,
        billboard=True,
        font_size=TEXT_M,
        color=INK,
        text=name,
    )


def _stamp(t_ns: int) -> Any:
    """A protobuf time of ns since 1970."""
    seconds, nanos = divmod(t_ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)


PICTURES = ("SceneUpdate", "Image", "Video", "PointCloud", "Grid", "LaserScan")
"""In names of schemas: what is drawn, and holds no reading of a sensor."""
Decode = Callable[[bytes], Any]


def read_log(path: Path, name: str) -> ForeignLog:
    """Any MCAP file as a log: a stream a topic, without pictures. Raises NotANumber."""
    messages: dict[str, list[Any]] = {}
    stamps: dict[str, list[int]] = {}
    decoders: dict[int, Decode | None] = {}
    about: Json = {}
    kinds: set[str] = set()
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            for schema, channel, message in reader.iter_messages():
                if channel.id not in decoders:
                    if channel.message_encoding == "cdr" and schema is not None:
                        kinds.add(schema.name)
                    decoders[channel.id] = _decoder(channel.message_encoding, schema)
                decode = decoders[channel.id]
                if decode is not None:
                    messages.setdefault(channel.topic, []).append(decode(message.data))
                    stamps.setdefault(channel.topic, []).append(message.log_time)
            for metadata in reader.iter_metadata():
                if metadata.name == "holdfast":
                    about = {
                        key: json_of(text) for key, text in metadata.metadata.items()
                    }
    except Exception as error:  # mcap and protobuf raise whatever their parsing meets
        raise NotANumber(
            f"cannot be read as MCAP ({type(error).__name__}: {str(error)[:120]})",
            where=path,
            cause="an interrupted recording or copy, or another format",
            next_step="mcap recover FILE writes what is left",
        ) from None

    streams = []
    for topic, rows in messages.items():
        try:
            columns = columns_of(rows, topic)
        except DataError:
            continue  # too many fields for readings of sensors
        t_ns = np.array(stamps[topic], dtype=np.uint64).astype(np.int64)
        streams.append(Stream(columns, t_ns))
    if kinds:
        from holdfast.interop.ros2 import unit_of_messages

        about |= unit_of_messages(kinds)
    return ForeignLog(path, name, tuple(streams), about)


def _decoder(encoding: str, schema: Any) -> Decode | None:
    """What makes a message dictionaries; None for a picture, or an encoding that is not known."""
    if schema is not None and any(word in schema.name for word in PICTURES):
        return None
    if encoding == "json":
        return json_of
    if encoding == "protobuf" and schema is not None:
        decode = DecoderFactory().decoder_for(encoding, schema)
        if decode is None:
            return None
        return lambda data: MessageToDict(
            decode(data),
            preserving_proto_field_name=True,
            always_print_fields_with_no_presence=True,
        )
    if encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        from holdfast.interop.ros2 import cdr_reader

        return cdr_reader(schema.name, schema.data.decode())
    return None
