"""Trials as MCAP files for Foxglove, `<name>.mcap`, and any MCAP file as a log.

| topic | schema | messages |
| --- | --- | --- |
| /tactile/fingers | holdfast.Fingers | a sample; a lost value is null |
| /situation | holdfast.Situation | each change of the label |

All messages are JSON. This module alone imports mcap and mcap_protobuf. `read_log` reads any file
whose messages are JSON, protobuf or those of ROS 2: each number is a column `topic.field`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import AXES, Json
from holdfast.core.errors import needs_extra
from holdfast.core.schema import json_of, message_of
from holdfast.interop.formats.payload import TrialPayload
from holdfast.interop.formats.streams import ForeignLog

with needs_extra("mcap"):
    from google.protobuf.json_format import MessageToDict
    from mcap.reader import NonSeekingReader
    from mcap.records import Schema
    from mcap.writer import Writer
    from mcap_protobuf.decoder import DecoderFactory

TEXT, NUMBER = {"type": "string"}, {"type": "number"}
NUMBER_OR_NULL = {"type": ["number", "null"]}
FINGER = {
    "type": "object",
    "properties": {
        **dict.fromkeys(AXES, NUMBER_OR_NULL),
        "valid": {"type": "boolean"},
    },
}
TOPICS: dict[str, tuple[str, Json]] = {
    "/tactile/fingers": (
        "holdfast.Fingers",
        {"unit": TEXT, "fingers": {"type": "array", "items": FINGER}},
    ),
    "/situation": (
        "holdfast.Situation",
        {"situation": TEXT, "by": TEXT, "t0_s": NUMBER, "t1_s": NUMBER},
    ),
}
"""Topic -> name of its schema, and the fields of a message."""


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
            channels = {}
            for topic, (name, fields) in TOPICS.items():
                # Foxglove names a JSON schema by its title.
                form = {"title": name, "type": "object", "properties": fields}
                schema = json.dumps(form).encode()
                number = writer.register_schema(name, "jsonschema", schema)
                channels[topic] = writer.register_channel(topic, "json", number)
            for topic, t_ns, message in _messages(trial):
                # allow_nan=False: the browser's JSON parser refuses a bare NaN.
                data = json.dumps(message, allow_nan=False).encode()
                writer.add_message(channels[topic], t_ns, data, publish_time=t_ns)
            writer.add_metadata("holdfast", about)
            writer.finish()


def _messages(trial: TrialPayload) -> Iterable[tuple[str, int, Json]]:
    """(topic, ns since 1970, message): situations, then sample by sample."""
    stamps = trial.t_ns.tolist()
    for first, stop, name in trial.phases():
        situation = {
            "situation": name,
            "by": trial.about["labels_by"],
            "t0_s": float(trial.t_s[first]),
            "t1_s": float(trial.t_s[stop - 1]),
        }
        yield "/situation", stamps[first], situation

    # JSON has no nan, so a lost value is None
    values = trial.values.astype(object)
    values[~np.isfinite(trial.values)] = None
    readings = values.reshape(len(stamps), -1, len(AXES)).tolist()
    for t_ns, of_row, valid in zip(stamps, readings, trial.valid.tolist(), strict=True):
        fingers: list[Json] = []
        for reading, is_valid in zip(of_row, valid, strict=True):
            fingers.append({"valid": is_valid, **dict(zip(AXES, reading, strict=True))})
        yield (
            "/tactile/fingers",
            t_ns,
            {"unit": trial.recording.unit, "fingers": fingers},
        )


PICTURES = ("SceneUpdate", "Image", "Video", "PointCloud", "Grid", "LaserScan")
"""In names of schemas: what is drawn, and holds no reading of a sensor."""
Decode = Callable[[bytes], Any]


def read_log(path: Path, name: str) -> ForeignLog:
    """Any MCAP file as a log: a stream a topic, without pictures.

    A file that was cut off is read as far as it goes, and noted.
    """
    messages: dict[str, list[tuple[int, Any]]] = {}
    decoders: dict[int, Decode | None] = {}
    about: Json = {}
    notes: tuple[str, ...] = ()
    try:
        with path.open("rb") as file:
            reader = NonSeekingReader(file, validate_crcs=True)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if schema is not None and schema.encoding == "ros2msg":
                    from holdfast.interop.formats.ros2 import read_log as read_bag

                    return read_bag(path, name)
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(channel.message_encoding, schema)
                decode = decoders[channel.id]
                if decode is not None:
                    sent = message.log_time, decode(message.data)
                    messages.setdefault(channel.topic, []).append(sent)

            file.seek(0)
            for record in NonSeekingReader(file).iter_metadata():
                if record.name == "holdfast":
                    about = {
                        key: json_of(value) for key, value in record.metadata.items()
                    }
    except Exception:  # mcap and protobuf raise whatever their parsing meets
        if not messages:
            raise
        notes = ("cut off: read as far as it goes",)

    from holdfast.interop.formats.tables import streams_of

    return ForeignLog(path, name, streams_of(messages, notes), about)


def _decoder(encoding: str, schema: Schema | None) -> Decode | None:
    """What makes a message dictionaries; None for a picture, or an encoding that is not known."""
    if schema is not None and any(word in schema.name for word in PICTURES):
        return None
    if encoding == "json":
        return message_of
    decode = DecoderFactory().decoder_for(encoding, schema)
    if decode is not None:
        return lambda data: MessageToDict(
            decode(data),
            preserving_proto_field_name=True,
            always_print_fields_with_no_presence=True,
        )

    return None
