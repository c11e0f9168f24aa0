"""Trials as MCAP files for Foxglove: `<name>.mcap`.

| topic | schema | messages |
| --- | --- | --- |
| /tactile/arrows | foxglove.SceneUpdate (protobuf) | a sample; an arrow a valid finger, a text |
| /tactile/fingers | holdfast.Fingers (JSON) | a sample; a lost value is null |
| /situation | holdfast.Situation (JSON) | each change of the label |
| /log | foxglove.Log (protobuf) | marks, changes of the label, fingers lost and back |
| /tf | foxglove.FrameTransform (protobuf) | one: the frame of the arrows |

This module alone imports mcap, mcap_protobuf and foxglove_schemas_protobuf.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.edge_runtime.contract import AXES, FloatArray
from holdfast.edge_runtime.extras import needs_extra
from holdfast.edge_runtime.reading import Json
from holdfast.interop.arrows import Pads, arrows, pads
from holdfast.interop.carried import CarriedTrial
from holdfast.interop.happenings import happenings

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
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap.writer import Writer
    from mcap_protobuf.schema import register_schema

ROOT_FRAME, FRAME = "world", "hand"
PAD_M, SHAFT_M, HEAD_M, TEXT_M = 0.012, 0.004, 0.008, 0.012
PAD = Color(r=0.55, g=0.58, b=0.62, a=0.9)
LOST = Color(r=0.1, g=0.1, b=0.1, a=0.3)
ARROW = Color(r=0.13, g=0.35, b=0.6, a=1.0)
INK = Color(r=0.12, g=0.16, b=0.2, a=1.0)
"""None is the colour of a situation: a finger has none."""
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


def write_trials(trials: Iterable[CarriedTrial], folder: Path) -> None:
    """One file for each trial below a folder."""
    for trial in trials:
        path = folder / f"{trial.name}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(library="holdfast")
            _write(_Topics(writer), trial)
            writer.add_metadata("holdfast", {key: json.dumps(x) for key, x in trial.about.items()})
            writer.finish()


@dataclass
class _Topics:
    """A writer whose topics appear with their first message."""

    writer: Writer
    _channels: dict[str, int] = field(default_factory=dict)

    def proto(self, topic: str, t_ns: int, message: Any) -> None:
        if topic not in self._channels:
            schema = register_schema(self.writer, type(message))
            self._channels[topic] = self.writer.register_channel(topic, "protobuf", schema)
        self._add(topic, t_ns, message.SerializeToString())

    def json(self, topic: str, t_ns: int, schema: str, message: Json) -> None:
        if topic not in self._channels:
            text = json.dumps({"title": schema, **SCHEMAS[schema]}).encode()
            number = self.writer.register_schema(schema, "jsonschema", text)
            self._channels[topic] = self.writer.register_channel(topic, "json", number)
        self._add(topic, t_ns, json.dumps(message, allow_nan=False).encode())

    def _add(self, topic: str, t_ns: int, data: bytes) -> None:
        self.writer.add_message(self._channels[topic], log_time=t_ns, data=data, publish_time=t_ns)


def _write(topics: _Topics, trial: CarriedTrial) -> None:
    stamps = trial.t_ns.tolist()
    frame = FrameTransform(
        timestamp=_stamp(stamps[0]),
        parent_frame_id=ROOT_FRAME,
        child_frame_id=FRAME,
        rotation=Quaternion(w=1.0),
    )
    topics.proto("/tf", stamps[0], frame)
    for one in happenings(trial):
        level = Log.WARNING if one.is_loss else Log.INFO
        message = Log(timestamp=_stamp(one.t_ns), level=level, message=one.text, name="holdfast")
        topics.proto("/log", one.t_ns, message)
    for first, stop, name in trial.phases():
        topics.json("/situation", stamps[first], "holdfast.Situation", {
            "situation": name,
            "by": trial.about["labels_by"],
            "t0_s": float(trial.t_s[first]),
            "t1_s": float(trial.t_s[stop - 1]),
        })  # fmt: skip
    _write_samples(topics, trial, stamps)


def _write_samples(topics: _Topics, trial: CarriedTrial, stamps: list[int]) -> None:
    where, names = pads(trial.n_sensors), trial.situations()
    for row, t_ns in enumerate(stamps):
        values, present = trial.values[row], trial.valid[row].tolist()
        entity = _hand(t_ns, np.where(np.isfinite(values), values, 0.0), present, trial, where)
        entity.texts.append(_text(names[row]))
        topics.proto("/tactile/arrows", t_ns, SceneUpdate(entities=[entity]))
        topics.json("/tactile/fingers", t_ns, "holdfast.Fingers", {
            "unit": trial.unit,
            "fingers": _fingers(values, present),
        })  # fmt: skip


def _fingers(values: FloatArray, valid: list[bool]) -> list[Json]:
    finite = [x if np.isfinite(x) else None for x in values.tolist()]
    return [
        {**dict(zip(AXES, finite[3 * k : 3 * k + 3], strict=True)), "valid": good}
        for k, good in enumerate(valid)
    ]


def _hand(
    t_ns: int, values: FloatArray, present: list[bool], trial: CarriedTrial, where: Pads
) -> Any:
    """All pads, and the arrows of those that were measured."""
    lengths, turns = arrows(values, trial.unit, where)
    entity = SceneEntity(timestamp=_stamp(t_ns), frame_id=FRAME, id="hand")
    for k, (x, y, z) in enumerate(where.at_m.tolist()):
        at = Vector3(x=x, y=y, z=z)
        size = Vector3(x=PAD_M, y=PAD_M, z=PAD_M)
        pose = Pose(position=at, orientation=Quaternion(w=1.0))
        entity.spheres.append(
            SpherePrimitive(pose=pose, size=size, color=PAD if present[k] else LOST)
        )
        if present[k]:
            entity.arrows.append(_arrow(at, float(lengths[k]), turns[k].tolist()))
    return entity


def _arrow(at: Any, length_m: float, turn: list[float]) -> Any:
    head_m = min(HEAD_M, length_m)
    return ArrowPrimitive(
        pose=Pose(position=at, orientation=Quaternion(**dict(zip("xyzw", turn, strict=True)))),
        shaft_length=length_m - head_m,
        shaft_diameter=SHAFT_M,
        head_length=head_m,
        head_diameter=2 * SHAFT_M,
        color=ARROW,
    )


def _text(name: str) -> Any:
    pose = Pose(position=Vector3(z=0.08), orientation=Quaternion(w=1.0))
    return TextPrimitive(pose=pose, billboard=True, font_size=TEXT_M, color=INK, text=name)


def _stamp(t_ns: int) -> Any:
    return Timestamp(seconds=t_ns // 1_000_000_000, nanos=t_ns % 1_000_000_000)
