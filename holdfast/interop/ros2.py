"""Trials as rosbag2 folders: `<name>/<..>.mcap` and `metadata.yaml`, CDR, standard messages alone.

| topic | message |
| --- | --- |
| /holdfast/finger_<n> | WrenchStamped (N), MagneticField (uT, as tesla) or Vector3Stamped (count) |
| /holdfast/situation | std_msgs/String, at each change of the label |
| /holdfast/log | std_msgs/String, marks and the like |
| /holdfast/about | std_msgs/String, once: JSON with unit, object, bias, .. |
| /diagnostics | DiagnosticArray, at the start and where a finger is lost or back |

A lost finger sends no message: the gap stays. This module alone imports rosbags. `read_log` reads
any bag: each number of a message is a column `topic.field`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import Unit
from holdfast.core.errors import ColumnError, NotANumber, needs_extra
from holdfast.core.reading import Json, json_of
from holdfast.interop.logs.log import ForeignLog, Stream, columns_of
from holdfast.interop.payload import TrialPayload, log_lines

with needs_extra("ros2"):
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TESLA_PER_UT = 1e-6
"""REP 103: ROS messages are in SI units."""
MESSAGE = {
    "N": "geometry_msgs/msg/WrenchStamped",
    "uT": "sensor_msgs/msg/MagneticField",
    "count": "geometry_msgs/msg/Vector3Stamped",
}
"""The message of a finger, by the unit of its reading."""
STRING = "std_msgs/msg/String"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
NS = 1_000_000_000
"""Nanoseconds in a second."""


def write_trials(trials: Iterable[TrialPayload], folder: Path) -> None:
    """One bag for each trial below a folder."""
    for trial in trials:
        # The writer makes the bag's own folder and refuses one that is there.
        place = folder / trial.name
        place.parent.mkdir(parents=True, exist_ok=True)
        with Writer(place, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            _write(_Bag(writer), trial)


class _Bag:
    """A writer whose topics appear with their first message, in messages of ROS 2 Humble."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of a type."""
        return self._store.types[kind](**fields)

    def text(self, topic: str, t_ns: int, text: str) -> None:
        """A std_msgs/String."""
        self.send(topic, t_ns, self.make(STRING, data=text))

    def send(self, topic: str, t_ns: int, message: Any) -> None:
        """Write it, by CDR."""
        kind = message.__msgtype__
        if topic not in self._connections:
            made = self._writer.add_connection(topic, kind, typestore=self._store)
            self._connections[topic] = made

        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], t_ns, data)

    def header(self, t_ns: int, frame: str) -> Any:
        """A std_msgs/Header."""
        sec, nanosec = divmod(t_ns, NS)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def vector(self, x: float, y: float, z: float) -> Any:
        """A geometry_msgs/Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _write(bag: _Bag, trial: TrialPayload) -> None:
    """All messages of a trial, topic by topic; a bag is read by the stamps of its messages."""
    stamps = trial.t_ns.tolist()
    bag.text("/holdfast/about", stamps[0], json.dumps(trial.about))

    for first, _, name in trial.phases():
        bag.text("/holdfast/situation", stamps[first], name)
    for line in log_lines(trial):
        bag.text("/holdfast/log", line.t_ns, line.text)

    # The first row differs from its own opposite, so the diagnostics start with it.
    opposite = ~trial.valid[:1]
    changed = np.diff(trial.valid, axis=0, prepend=opposite).any(axis=1)
    for row in np.flatnonzero(changed).tolist():
        valid = trial.valid[row].tolist()
        message = _diagnostics(bag, stamps[row], valid)
        bag.send("/diagnostics", stamps[row], message)

    values = trial.values.reshape(-1, trial.n_sensors, 3)
    # A lost finger sends nothing: a message of zeros would look like a reading.
    for row, sensor in np.argwhere(trial.valid).tolist():
        frame = f"finger_{sensor + 1}"
        reading = values[row, sensor].tolist()
        message = _measured(bag, trial.unit, stamps[row], frame, reading)
        bag.send(f"/holdfast/{frame}", stamps[row], message)


def _measured(
    bag: _Bag, unit: Unit, t_ns: int, frame: str, reading: list[float]
) -> Any:
    """A finger's reading (x, y, z) as the message of its unit."""
    header = bag.header(t_ns, frame)
    kind = MESSAGE[unit]

    if unit == "N":
        # A fingertip measures no torque, and a Wrench needs one.
        torque = bag.vector(0.0, 0.0, 0.0)
        force = bag.vector(*reading)
        wrench = bag.make("geometry_msgs/msg/Wrench", force=force, torque=torque)
        return bag.make(kind, header=header, wrench=wrench)

    if unit == "uT":
        tesla = [TESLA_PER_UT * value for value in reading]
        return bag.make(
            kind,
            header=header,
            magnetic_field=bag.vector(*tesla),
            # 0 means "covariance unknown" in this message.
            magnetic_field_covariance=np.zeros(9),
        )

    # Counts have no message of their own: a plain vector claims no physical quantity.
    return bag.make(kind, header=header, vector=bag.vector(*reading))


def _diagnostics(bag: _Bag, t_ns: int, valid: list[bool]) -> Any:
    """One status a finger: level 0 is OK, 2 is an error."""
    statuses = []
    for number, is_valid in enumerate(valid, 1):
        status = bag.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0 if is_valid else 2,
            name=f"holdfast: finger {number}",
            message="valid" if is_valid else "lost",
            hardware_id=f"finger_{number}",
            values=[],
        )
        statuses.append(status)
    # The fingers have frames of their own; a status of all of them has none.
    header = bag.header(t_ns, "")
    return bag.make(DIAGNOSTICS, header=header, status=statuses)


UNIT_OF_MESSAGE = {
    "geometry_msgs/msg/WrenchStamped": "N",
    "geometry_msgs/msg/Wrench": "N",
    "sensor_msgs/msg/MagneticField": "T",
}
"""What the standard messages of a finger are in (REP 103)."""
ABOUT = "/holdfast/about"
MOST_LIST = 256
"""Numbers of a list that become columns; an image or a point cloud has more, and is left out."""


def read_log(folder: Path, name: str) -> ForeignLog:
    """A bag of ROS 2 as a log: a stream a topic. Raises NotANumber."""
    messages: dict[str, list[Any]] = {}
    stamps: dict[str, list[int]] = {}
    kinds = {}
    try:
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([folder], default_typestore=store) as bag:
            for connection, t_ns, data in bag.messages():
                topic = connection.topic
                message = bag.deserialize(data, connection.msgtype)
                kinds[topic] = connection.msgtype
                messages.setdefault(topic, []).append(plain_message(message))
                stamps.setdefault(topic, []).append(int(t_ns))
    except Exception as error:  # rosbags raises whatever its parsing meets
        raise NotANumber(
            f"cannot be read as a bag of ROS 2 ({type(error).__name__})",
            where=folder,
            cause="an interrupted recording, or messages whose types it does not hold",
            next_step="ros2 bag reindex, or ros2 bag convert to MCAP with its types",
        ) from None

    about = _about(messages.pop(ABOUT, []))
    about |= unit_of_messages(kinds.values())
    return ForeignLog(folder, name, streams_of(messages, stamps, folder), about)


def unit_of_messages(kinds: Iterable[str]) -> Json:
    """{"unit": ..} where the messages of a bag say one; a key of UNIT_OF."""
    units = {UNIT_OF_MESSAGE[kind] for kind in kinds if kind in UNIT_OF_MESSAGE}
    return {"unit": units.pop()} if len(units) == 1 else {}


def streams_of(
    messages: dict[str, list[Any]], stamps: dict[str, list[int]], path: Path
) -> tuple[Stream, ...]:
    """A stream for each topic whose messages are small enough to be columns."""
    streams = []
    for topic, rows in messages.items():
        try:
            columns = columns_of(rows, topic, path)
        except ColumnError:
            continue  # an image, or the like
        if columns:
            streams.append(Stream(columns, np.array(stamps[topic], dtype=np.int64)))
    return tuple(streams)


def plain_message(message: Any) -> Any:
    """A message as dictionaries, lists, numbers and texts; a time as ns."""
    if hasattr(message, "__msgtype__") or hasattr(message, "__dataclass_fields__"):
        fields = [key for key in message.__dataclass_fields__ if key != "__msgtype__"]
        value = {key: plain_message(getattr(message, key)) for key in fields}
        if value.keys() == {"sec", "nanosec"}:
            return value["sec"] * NS + value["nanosec"]
        return value
    if isinstance(message, np.ndarray):
        return message.tolist() if message.size <= MOST_LIST else None
    if isinstance(message, list | tuple):
        return [plain_message(one) for one in message[: MOST_LIST + 1]]
    if isinstance(message, bytes):
        return None
    return message


def cdr_reader(name: str, definition: str) -> Callable[[bytes], Any]:
    """Reads messages of a type whose definition a file holds, such as an MCAP file of ROS 2.

    Raises NotANumber.
    """
    try:
        store = get_typestore(Stores.ROS2_HUMBLE)
        kind = name if "/msg/" in name else name.replace("/", "/msg/", 1)
        for other, types in get_types_from_msg(definition, kind).items():
            if other not in store.types:
                store.register({other: types})
    except Exception as error:  # the parser of definitions raises errors of its own
        raise NotANumber(
            f"the type {name:.60} cannot be read ({type(error).__name__})",
            next_step="record the bag with the definitions of its types",
        ) from None
    return lambda data: plain_message(store.deserialize_cdr(data, kind))


def _about(messages: list[Any]) -> Json:
    """What `holdfast convert` says of the trial, as it wrote it."""
    try:
        about = json_of(messages[0]["data"]) if messages else {}
    except (KeyError, TypeError, ValueError):
        return {}
    return about if isinstance(about, dict) else {}
