"""ROS 2 bags as single MCAP files."""

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
"""ROS message types of a written bag, by topic."""
_FOREVER = QosTime(9223372036, 854775807)
_RELIABILITY, _DURABILITY = QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
_TIMES = _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER
_LATCHED = Qos(QosHistory.KEEP_LAST, 1, _RELIABILITY, _DURABILITY, *_TIMES, False)
_LATCHED_TOPICS = ("/map", "/tf_static")


class BagWriter:
    """Writer of a ROS 2 bag. The file appears at `path` when the bag is complete."""

    def __init__(self, path: str | Path) -> None:
        """Start a bag `NAME.mcap` with `TOPICS`, replacing any existing file.

        Raises:
            ValueError: another suffix.
            OSError: the bag cannot be written.
        """
        self.path = path = Path(path)
        if path.suffix != ".mcap":
            raise ValueError(f"bags are written as .mcap, got {path}")
        self._folder = temporary_beside(path)
        shutil.rmtree(self._folder, ignore_errors=True)
        # Metadata hold the final file name. Before ROS 2 Jazzy, only versions below 9 are readable.
        self._writer = Writer(self._folder / path.stem, version=8, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        self._connections = {topic: self._connect(topic, kind) for topic, kind in TOPICS.items()}

    def _connect(self, topic: str, kind: str) -> Any:
        qos = [_LATCHED] if topic in _LATCHED_TOPICS else []
        return self._writer.add_connection(topic, kind, typestore=typestore(), offered_qos_profiles=qos)

    def write(self, topic: str, time: float, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._connect(topic, message.__msgtype__)
        data = typestore().serialize_cdr(message, message.__msgtype__)
        self._writer.write(self._connections[topic], round(time * 1e9), data)

    def close(self) -> None:
        """Finish the bag and move the file to `path`. A failure raises OSError and leaves no file."""
        try:
            self._writer.close()
            written = self._folder / self.path.stem / self.path.name
            with written.open("rb") as file:
                os.fsync(file.fileno())
            written.replace(self.path)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def discard(self) -> None:
        self._writer.abort()
        shutil.rmtree(self._folder, ignore_errors=True)
