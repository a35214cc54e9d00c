"""ROS 2 bags as single MCAP files, written by the library rosbags."""

import os
import shutil
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from lidarnaut.envs.files import temporary_beside

from .messages import typestore

TOPICS = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/plan": "nav_msgs/msg/Path",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
}
"""Types of the messages by topic."""
_FOREVER = QosTime(9223372036, 854775807)
_RELIABILITY, _DURABILITY = QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
_TIMES = _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER
_LATCHED = Qos(QosHistory.KEEP_LAST, 1, _RELIABILITY, _DURABILITY, *_TIMES, False)
"""Quality of service of what late subscribers get as well."""
_LATCHED_TOPICS = ("/map", "/tf_static")


class BagWriter:
    """Writes a bag under a temporary name, which `close` replaces by its own: there is a whole bag, or none."""

    def __init__(self, path: Path) -> None:
        """Start a bag `NAME.mcap`, in place of one that is there, with `TOPICS`; further ones begin when written to.

        Raises:
            ValueError: for another suffix.
            OSError: if it cannot be written.
        """
        if path.suffix != ".mcap":
            raise ValueError(f"bags are written as .mcap, got {path}")
        self.path = path
        self._folder = temporary_beside(path)
        shutil.rmtree(self._folder, ignore_errors=True)
        # The bag names its file, which must therefore have its final name from the start. Releases before ROS 2 Jazzy
        # cannot read metadata from version 9 on.
        self._writer = Writer(self._folder / path.stem, version=8, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        self._connections = {topic: self._connect(topic, kind) for topic, kind in TOPICS.items()}

    def _connect(self, topic: str, kind: str) -> Any:
        qos = [_LATCHED] if topic in _LATCHED_TOPICS else []
        return self._writer.add_connection(topic, kind, typestore=typestore(), offered_qos_profiles=qos)

    def write(self, topic: str, time: float, message: Any) -> None:
        """Write a message at a time [s]."""
        if topic not in self._connections:
            self._connections[topic] = self._connect(topic, message.__msgtype__)
        data = typestore().serialize_cdr(message, message.__msgtype__)
        self._writer.write(self._connections[topic], round(time * 1e9), data)

    def close(self) -> None:
        """Finish the bag and put it in its place; OSError if it cannot be written; nothing is left of it."""
        try:
            self._writer.close()
            written = self._folder / self.path.stem / self.path.name
            with written.open("rb") as file:
                os.fsync(file.fileno())
            written.replace(self.path)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def discard(self) -> None:
        """Remove what was written."""
        self._writer.abort()
        shutil.rmtree(self._folder, ignore_errors=True)
