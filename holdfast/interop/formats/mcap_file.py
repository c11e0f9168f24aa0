"""Trials as MCAP files for Foxglove, `<name>.mcap`, and any MCAP file as a log.

| topic | messages |
| --- | --- |
| /tactile/fingers | a sample; a lost value is null |
| /situation | each change of the label |

All messages are JSON. This module alone imports mcap and mcap_protobuf. `read_log` reads any file
whose messages are JSON, protobuf or those of ROS 2: each number is a column `topic.field`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import AXES, Json
from holdfast.core.errors import needs_extra
from holdfast.core.schema import json_of, message_of
from holdfast.data.metrics import run_starts
from holdfast.interop.formats.payload import LABELS, TrialPayload
from holdfast.interop.formats.streams import ForeignLog

with needs_extra("mcap"):
    from google.protobuf.json_format import MessageToDict
    from mcap.reader import NonSeekingReader
    from mcap.records import Schema
    from mcap.writer import Writer
    from mcap_protobuf.decoder import DecoderFactory

TEXT, NUMBER = {"type": "string"}, {"type": "number"}
FINGER = {**dict.fromkeys(AXES, NUMBER), "valid": {"type": "boolean"}}
"""What a message has of each sensor; viewers refuse a field of two types, and take a null."""
FIELDS = {
    "/tactile/fingers": {
        "unit": TEXT,
        "fingers": {"type": "array", "items": {"type": "object", "properties": FINGER}},
    },
    "/situation": {"situation": TEXT},
}
"""Topic -> the fields of a message, as JSON Schema."""


def write_trials(trials: Iterable[TrialPayload], folder: Path) -> None:
    """One file for each trial below a folder."""
    for trial in trials:
        path = folder / f"{trial.recording.trial_id}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = Writer(str(path))
        writer.start(library="holdfast")
        channels = {}
        for topic, fields in FIELDS.items():
            schema = json.dumps({"type": "object", "properties": fields}).encode()
            number = writer.register_schema(f"holdfast{topic}", "jsonschema", schema)
            channels[topic] = writer.register_channel(topic, "json", number)
        for topic, t_ns, message in _messages(trial):
            data = json.dumps(message).encode()
            writer.add_message(channels[topic], t_ns, data, t_ns)
        # The metadata of MCAP are texts, so each value is JSON of its own.
        about = {key: json.dumps(value) for key, value in trial.about.items()}
        writer.add_metadata("holdfast", about)
        writer.finish()


def _messages(trial: TrialPayload) -> Iterable[tuple[str, int, Json]]:
    """(topic, ns since 1970, message): situations, then sample by sample."""
    start = datetime.fromisoformat(trial.about["started_utc"] or "1970-01-01T00:00:00Z")
    start_ns = int(1e9 * start.timestamp())
    stamps = (start_ns + np.round(1e9 * trial.t_s).astype(np.int64)).tolist()
    for row in run_starts(trial.label):
        yield "/situation", stamps[row], {"situation": LABELS[trial.label[row]]}

    # JSON has no nan, so a lost value is None
    values = np.where(np.isfinite(trial.values), trial.values, np.array(None))
    valid = trial.recording.valid[:, :, None]
    readings = np.append(values.reshape(len(values), -1, len(AXES)), valid, axis=2)
    for t_ns, row in zip(stamps, readings.tolist(), strict=True):
        fingers = [dict(zip(FINGER, one, strict=True)) for one in row]
        message = {"unit": trial.recording.unit, "fingers": fingers}
        yield "/tactile/fingers", t_ns, message


PICTURE = re.compile("SceneUpdate|Image|Video|PointCloud|Grid|LaserScan")
"""In names of schemas: what is drawn, and holds no reading of a sensor."""


def read_log(path: Path, name: str) -> ForeignLog:
    """Any MCAP file as a log: a stream a topic, without pictures.

    A file that was cut off is read as far as it goes, and noted.
    """
    messages: dict[str, Any] = {}
    decoders = {}
    about: Json = {}
    notes: tuple[str, ...] = ()
    try:
        with path.open("rb") as file:
            reader = NonSeekingReader(file, validate_crcs=True)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if schema and schema.encoding == "ros2msg":
                    from holdfast.interop.formats.ros2 import read_log as read_bag

                    return read_bag(path, name)
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(channel.message_encoding, schema)
                decode = decoders[channel.id]
                if decode:
                    sent = message.log_time, decode(message.data)
                    messages.setdefault(channel.topic, []).append(sent)

            file.seek(0)
            for record in NonSeekingReader(file).iter_metadata():
                if record.name == "holdfast":
                    values = record.metadata.items()
                    about = {key: json_of(value) for key, value in values}
    except Exception:  # mcap and protobuf raise whatever their parsing meets
        if not messages:
            raise
        notes = ("cut off: read as far as it goes",)

    from holdfast.interop.formats.tables import streams_of

    return ForeignLog(path, name, streams_of(messages, notes), about)


def _decoder(encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
    """What makes a message dictionaries; None for a picture, or an encoding that is not known."""
    if schema and PICTURE.search(schema.name):
        return None
    if encoding == "json":
        return message_of
    decode = DecoderFactory().decoder_for(encoding, schema)
    if decode is None:
        return None
    return lambda data: MessageToDict(
        decode(data),
        preserving_proto_field_name=True,
        always_print_fields_with_no_presence=True,
    )
