"""Bags of ROS 2 as logs: each number of a message is a column `topic.field`.

This module alone imports rosbags.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields as fields_of
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import Json
from holdfast.core.errors import NotANumber, needs_extra
from holdfast.interop.streams import ForeignLog, streams_of

with needs_extra("ros2"):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

NS = 1_000_000_000
"""Nanoseconds in a second."""
UNIT_OF_MESSAGE = {
    "geometry_msgs/msg/WrenchStamped": "N",
    "geometry_msgs/msg/Wrench": "N",
    "sensor_msgs/msg/MagneticField": "T",
}
"""What the standard messages of a finger are in (REP 103)."""
MOST_LIST = 256
"""Numbers of a list that become columns; an image or a point cloud has more, and is left out."""


def read_log(folder: Path, name: str) -> ForeignLog:
    """A bag of ROS 2, or its MCAP file, as a log: a stream a topic. Raises NotANumber."""
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

    about = unit_of_messages(kinds.values())
    return ForeignLog(folder, name, streams_of(messages, stamps), about)


def unit_of_messages(kinds: Iterable[str]) -> Json:
    """{"unit": ..} where the messages of a bag say one; a key of UNIT_OF."""
    units = {UNIT_OF_MESSAGE[kind] for kind in kinds if kind in UNIT_OF_MESSAGE}
    return {"unit": units.pop()} if len(units) == 1 else {}


def plain_message(message: Any) -> Any:
    """A message as dictionaries, lists, numbers and texts; a time as ns."""
    if is_dataclass(message):
        fields = [one.name for one in fields_of(message) if one.name != "__msgtype__"]
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
