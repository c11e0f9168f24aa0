"""Bags of ROS 2 by rosbags' own writer: what the tests of the reader read."""

from __future__ import annotations

from typing import Any

from rosbags.rosbag2 import StoragePlugin as StoragePlugin
from rosbags.rosbag2 import Writer as Writer
from rosbags.typesys import Stores as Stores
from rosbags.typesys import get_typestore as get_typestore

STRING = "std_msgs/msg/String"

NS = 1_000_000_000
"""Nanoseconds in a second."""


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
