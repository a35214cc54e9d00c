"""Bags of all formats for tests of the reader."""

import math

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SCAN, ODOMETRY, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class Messages:
    def __init__(self, store):
        self.store = get_typestore(store)
        if TF not in self.store.types:  # ROS 1 has the type in another package
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))

    def make(self, kind, *args, **fields):
        return self.store.types[kind](*args, **fields)

    def header(self, seconds, frame):
        stamp = self.make("builtin_interfaces/msg/Time", int(seconds), round(seconds % 1 * 1e9))
        seq = {"seq": 0} if "seq" in self.store.types["std_msgs/msg/Header"].__dataclass_fields__ else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **seq)

    def quaternion(self, yaw=0.0, roll=0.0):
        """Return the rotation by roll about x, followed by yaw about z."""
        (cy, sy), (cr, sr) = ((math.cos(a / 2), math.sin(a / 2)) for a in (yaw, roll))
        return self.make("geometry_msgs/msg/Quaternion", cy * sr, sy * sr, sy * cr, cy * cr)

    def scan(self, seconds, ranges, frame="laser", angle_min=-1.0, step=0.5, range_min=0.1, range_max=8.0):
        ranges = np.array(ranges, dtype=np.float32)
        beams = (angle_min, angle_min + step * (len(ranges) - 1), step, 0.0, 0.1, range_min, range_max)
        return self.make(SCAN, self.header(seconds, frame), *beams, ranges, np.array([], dtype=np.float32))

    def odometry(self, seconds, x, y, yaw, base="base_link"):
        point, zero = self.make("geometry_msgs/msg/Point", x, y, 0.0), np.zeros(36)
        pose = self.make("geometry_msgs/msg/Pose", point, self.quaternion(yaw))
        still = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/msg/Twist", still, still)
        pose = self.make("geometry_msgs/msg/PoseWithCovariance", pose, zero)
        twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist, zero)
        return self.make(ODOMETRY, self.header(seconds, "odom"), base, pose, twist)

    def transforms(self, seconds, *edges):
        """`edges`: (parent, child, x, y, yaw, roll)."""
        stamped = []
        for parent, child, x, y, yaw, roll in edges:
            moved = self.make("geometry_msgs/msg/Vector3", x, y, 0.2)
            transform = self.make("geometry_msgs/msg/Transform", moved, self.quaternion(yaw, roll))
            header = self.header(seconds, parent)
            stamped.append(self.make("geometry_msgs/msg/TransformStamped", header, child, transform))
        return self.make(TF, stamped)


def write_bag(path, messages, storage="mcap", compression=None):
    """Write (topic, message) pairs, a second apart, into a bag; return its path.

    Args:
        path: path of the bag without suffix.
        messages: function of `Messages` that returns the pairs.
        storage: "ros1" (`path.bag`), "sqlite3" or "mcap" (a folder), or "file" (`path.mcap`).
        compression: None, "BZ2" or "LZ4" for ROS 1, "STORAGE" or "MESSAGE" (Zstandard) for ROS 2.
    """
    ros1 = storage == "ros1"
    maker = Messages(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    pairs = list(messages(maker))
    if ros1:
        path = path.with_suffix(".bag")
        writer = Writer1(path)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
    else:
        plugin = StoragePlugin.SQLITE3 if storage == "sqlite3" else StoragePlugin.MCAP
        writer = Writer2(path, version=8, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    serialize = maker.store.serialize_ros1 if ros1 else maker.store.serialize_cdr
    with writer:
        connections = {}
        for k, (topic, message) in enumerate(pairs):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=maker.store)
            writer.write(connections[topic], (k + 1) * 10**9, serialize(message, kind))
    if storage == "file":
        return (path / f"{path.name}.mcap").rename(path.with_suffix(".mcap"))
    return path


def drive(m):
    """Three scans on a straight drive along x, between odometry messages 0.1 s apart."""
    yield "/tf_static", m.transforms(0.0, ("base_link", "mast", 0.1, 0.0, math.pi / 2, 0.0))
    yield "/tf_static", m.transforms(0.0, ("mast", "laser", 0.2, 0.0, 0.0, 0.0))
    for k in range(4):
        yield "/odom", m.odometry(10.0 + 0.1 * k, 0.5 * k, 0.0, 0.0)
    for k in range(3):
        yield "/scan", m.scan(10.05 + 0.1 * k, [1.0, 0.05, math.nan, 8.0, 8.1])
