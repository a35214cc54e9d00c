"""Bags and scans by Debian's packages of ROS 1."""

from collections import defaultdict

import rosbag
import rospy
from client import plain
from laser_geometry import LaserProjection
from sensor_msgs import point_cloud2
from tf2_py import BufferCore


def read(path):
    messages = defaultdict(list)
    with rosbag.Bag(path) as bag:
        for topic, message, time in bag.read_messages():
            messages[topic].append([time.to_nsec(), plain(message)])
    return {"messages": messages}


def write(source, folder):
    """Write a bag with other compressions and small chunks; return the paths by compression."""
    found = {f"rosbag, {packing}": f"{folder}/debian_{packing}.bag" for packing in ("none", "bz2", "lz4")}
    for name, path in found.items():
        packing = name.partition(", ")[2]
        with rosbag.Bag(source) as bag, rosbag.Bag(path, "w", compression=packing, chunk_threshold=20_000) as written:
            for topic, message, time in bag.read_messages():
                written.write(topic, message, time)
    return found


def place(path):
    """Return the end points of each scan in its own frame [m], and the pose of this frame in `odom`."""
    buffer, projection, placed = BufferCore(rospy.Duration(1e6)), LaserProjection(), []
    with rosbag.Bag(path) as bag:
        for topic, message, _ in bag.read_messages(("/tf", "/tf_static")):
            add = buffer.set_transform_static if topic == "/tf_static" else buffer.set_transform
            for transform in message.transforms:
                add(transform, "bag")
        for _, scan, _ in bag.read_messages("/scan"):
            points = point_cloud2.read_points(projection.projectLaser(scan), ("x", "y", "z"))
            found = buffer.lookup_transform_core("odom", scan.header.frame_id, scan.header.stamp)
            placed.append([list(points), plain(found.transform)])
    return placed
