"""Bags of ROS 2 as logs: each number of a message is a column `topic.field`.

This module alone imports rosbags.
"""

from __future__ import annotations

from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.errors import needs_extra
from holdfast.interop.formats.streams import ForeignLog
from holdfast.interop.formats.tables import streams_of

with needs_extra("ros2"):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

UNIT_OF_MESSAGE = {
    "geometry_msgs/msg/WrenchStamped": "N",
    "geometry_msgs/msg/Wrench": "N",
    "sensor_msgs/msg/MagneticField": "T",
}
"""What the standard messages of a finger are in (REP 103)."""
MOST_LIST = 256
"""Numbers of a list that become columns; an image or a point cloud has more, and is left out."""
HIDDEN = ("sec", "nanosec")
"""Fields of a message that are no columns: the recorder's stamps are the time."""


def read_log(folder: Path, name: str) -> ForeignLog:
    """A bag of ROS 2, or its MCAP file, as a log: a stream a topic."""
    messages: dict[str, list[tuple[int, Any]]] = {}
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([folder], default_typestore=store) as bag:
        units = {UNIT_OF_MESSAGE.get(one.msgtype) for one in bag.connections} - {None}
        for connection, t_ns, data in bag.messages():
            message = plain_message(bag.deserialize(data, connection.msgtype))
            messages.setdefault(connection.topic, []).append((t_ns, message))

    about = {"unit": units.pop()} if len(units) == 1 else {}
    return ForeignLog(folder, name, streams_of(messages), about)


def plain_message(message: Any) -> Any:
    """A message as dictionaries, lists, numbers and texts, without its times and its pictures."""
    if is_dataclass(message):
        fields = vars(message).items()
        return {key: plain_message(one) for key, one in fields if key not in HIDDEN}
    if isinstance(message, np.ndarray):
        return message.tolist() if message.size <= MOST_LIST else None
    if isinstance(message, list):
        return [plain_message(one) for one in message]
    return message
