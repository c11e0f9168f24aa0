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
from holdfast.interop.payload import TrialPayload, log_lines

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


def write_trials(trials: Iterable[TrialPayload], folder: Path) -> None:
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


def _write(bag: _Bag, trial: TrialPayload) -> None:
    stamps, there = trial.t_ns.tolist(), trial.valid
    bag.text("/holdfast/about", stamps[0], json.dumps(trial.about))
    for first, _, name in trial.phases():
        bag.text("/holdfast/situation", stamps[first], name)
    for line in log_lines(trial):
        bag.text("/holdfast/log", line.t_ns, line.text)
    # The first row differs from its own opposite, so the diagnostics start with it.
    changed = np.diff(there, axis=0, prepend=~there[:1]).any(axis=1)
    for row in np.flatnonzero(changed).tolist():
        t_ns = stamps[row]
        bag.send("/diagnostics", t_ns, _diagnostics(bag, t_ns, there[row].tolist()))
    for row, sensor in np.argwhere(there).tolist():
        x, y, z = trial.values[row, 3 * sensor : 3 * sensor + 3].tolist()
        frame, t_ns = f"finger_{sensor + 1}", stamps[row]
        message = _measured(bag, trial, t_ns, frame, bag.vector(x, y, z))
        bag.send(f"/holdfast/{frame}", t_ns, message)


def _measured(
    bag: _Bag, trial: TrialPayload, t_ns: int, frame: str, vector: Any
) -> Any:
    """A finger's reading as the message of its unit; a torque is not measured, so it is zero."""
    header, kind = bag.header(t_ns, frame), MESSAGE[trial.unit]
    if trial.unit == "N":
        torque = bag.vector(0.0, 0.0, 0.0)
        wrench = bag.make("geometry_msgs/msg/Wrench", force=vector, torque=torque)
        return bag.make(kind, header=header, wrench=wrench)
    if trial.unit == "uT":
        return bag.make(
            kind,
            header=header,
            magnetic_field=bag.vector(
                TESLA_PER_UT * vector.x,
                TESLA_PER_UT * vector.y,
                TESLA_PER_UT * vector.z,
            ),
            # 0 means "covariance unknown" in this message.
            magnetic_field_covariance=np.zeros(9),
        )
    return bag.make(kind, header=header, vector=vector)


def _diagnostics(bag: _Bag, t_ns: int, there: list[bool]) -> Any:
    """One status a finger: level 0 is OK, 2 is an error."""
    status = []
    for number, valid in enumerate(there, 1):
        finger = bag.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0 if valid else 2,
            name=f"holdfast: finger {number}",
            message="valid" if valid else "lost",
            hardware_id=f"finger_{number}",
            values=[],
        )
        status.append(finger)
    return bag.make(DIAGNOSTICS, header=bag.header(t_ns, ""), status=status)
