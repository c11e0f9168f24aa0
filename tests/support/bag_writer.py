"""Bags of ROS 2 by rosbags' own writer: what the tests of the reader read."""

from __future__ import annotations

from rosbags.rosbag2 import StoragePlugin as StoragePlugin
from rosbags.rosbag2 import Writer as Writer
from rosbags.typesys import Stores as Stores
from rosbags.typesys import get_typestore as get_typestore
