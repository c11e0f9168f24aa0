"""Trials as rosbag2 folders: `<name>/<..>.mcap` and `metadata.yaml`, CDR, standard messages alone.

| topic | message |
| --- | --- |
| /holdfast/finger_<n> | WrenchStamped (N), MagneticField (uT, as tesla) or Vector3Stamped (count) |
| /holdfast/situation | std_msgs/String, at each change of the label |
| /holdfast/log | std_msgs/String, marks and the like |
| /holdfast/about | std_msgs/String, once: JSON with unit, object, bias, .. |
| /diagnostics | DiagnosticArray, at the start and where a finger is lost or back |

A lost finger sends no message: the gap stays. This module alone imports rosbags.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.errors import needs_extra
from holdfast.interop.payload import CarriedTrial, happenings

with needs_extra("ros2"):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

TESLA_PER_UT = 1e-6
MESSAGE = {
    "N": "geometry_msgs/msg/WrenchStamped",
    "uT": "sensor_msgs/msg/MagneticField",
    "count": "geometry_msgs/msg/Vector3Stamped",
}
STRING, DIAGNOSTICS = "std_msgs/msg/String", "diagnostic_msgs/msg/DiagnosticArray"
NS = 1_000_000_000


def write_trials(trials: Iterable[CarriedTrial], folder: Path) -> None:
    """One bag for each trial below a folder."""
    for trial in trials:
        place = folder / trial.name
        place.parent.mkdir(parents=True, exist_ok=True)
        with Writer(place, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            _write(_Bag(writer), trial)


class _Bag:
    """A writer whose topics appear with their first message, in messages of ROS 2 Humble."""

    def __init__(self, writer: Any) -> None:
        self._writer, self._store = writer, get_typestore(Stores.ROS2_HUMBLE)
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
        stamp = self.make(
            "builtin_interfaces/msg/Time", sec=t_ns // NS, nanosec=t_ns % NS
        )
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def vector(self, x: float, y: float, z: float) -> Any:
        """A geometry_msgs/Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _write(bag: _Bag, trial: CarriedTrial) -> None:
    stamps, there = trial.t_ns.tolist(), trial.valid
    bag.text("/holdfast/about", stamps[0], json.dumps(trial.about))
    for first, _, name in trial.phases():
        bag.text("/holdfast/situation", stamps[first], name)
    for one in happenings(trial):
        bag.text("/holdfast/log", one.t_ns, one.text)
    changed = np.flatnonzero((np.diff(there, axis=0, prepend=~there[:1])).any(axis=1))
    for row in changed.tolist():
        bag.send(
            "/diagnostics",
            stamps[row],
            _diagnostics(bag, stamps[row], there[row].tolist()),
        )
    for row, sensor in np.argwhere(there).tolist():
        vector = bag.vector(*trial.values[row, 3 * sensor : 3 * sensor + 3].tolist())
        topic = f"finger_{sensor + 1}"
        bag.send(
            f"/holdfast/{topic}",
            stamps[row],
            _measured(bag, trial, stamps[row], topic, vector),
        )


def _measured(
    bag: _Bag, trial: CarriedTrial, t_ns: int, frame: str, vector: Any
) -> Any:
    """A finger's reading as the message of its unit; a torque is not measured, so it is zero."""
    header, kind = bag.header(t_ns, frame), MESSAGE[trial.unit]
    if trial.unit == "N":
        torque = bag.vector(0.0, 0.0, 0.0)
        wrench = bag.make("geometry_msgs/msg/Wrench", force=vector, torque=torque)
        return bag.make(kind, header=header, wrench=wrench)
    if trial.unit == "uT":
        tesla = bag.vector(*(TESLA_PER_UT * x for x in (vector.x, vector.y, vector.z)))
        unknown = np.zeros(9)  # 0 means "covariance unknown" in this message
        return bag.make(
            kind, header=header, magnetic_field=tesla, magnetic_field_covariance=unknown
        )
    return bag.make(kind, header=header, vector=vector)


def _diagnostics(bag: _Bag, t_ns: int, there: list[bool]) -> Any:
    """One status a finger: level 0 is OK, 2 is an error."""
    status = [
        bag.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0 if good else 2,
            name=f"holdfast: finger {k + 1}",
            message="valid" if good else "lost",
            hardware_id=f"finger_{k + 1}",
            values=[],
        )
        for k, good in enumerate(there)
    ]
    return bag.make(DIAGNOSTICS, header=bag.header(t_ns, ""), status=status)
