"""Bags and scans by Debian's packages of ROS 1: `debian.py FUNCTION ARGUMENTS...`; prints JSON."""

import json
import sys
from collections import defaultdict

import numpy as np
import rosbag
import rospy
from geometry_msgs.msg import TransformStamped
from laser_geometry import LaserProjection
from plain import plain
from sensor_msgs import point_cloud2
from sensor_msgs.msg import LaserScan
from tf2_py import BufferCore, TransformException


def read(path):
    messages = defaultdict(list)
    with rosbag.Bag(path) as bag:
        for topic, message, time in bag.read_messages():
            messages[topic].append([time.to_nsec(), plain(message)])
    return {"messages": messages}


def write(source, folder):
    found = {}
    for packing in ("none", "bz2", "lz4"):
        path = found[f"rosbag, {packing}"] = f"{folder}/debian_{packing}.bag"
        with rosbag.Bag(source) as bag, rosbag.Bag(path, "w", compression=packing, chunk_threshold=20_000) as written:
            for topic, message, time in bag.read_messages():
                written.write(topic, message, time)
    return found


def place():
    """Return the end points of the beams of each scan in the frame `odom` [m], by laser_geometry and tf2."""
    given, buffer = json.load(sys.stdin), BufferCore(rospy.Duration(1e6))
    for topic in ("/tf_static", "/tf"):
        for _, message in given[topic]:
            for one in message["transforms"]:
                made = TransformStamped()
                made.header.stamp, made.header.frame_id = time_of(one["header"]), one["header"]["frame_id"]
                made.child_frame_id = one["child_frame_id"]
                for part in ("translation", "rotation"):
                    for axis, value in one["transform"][part].items():
                        setattr(getattr(made.transform, part), axis, value)
                (buffer.set_transform_static if topic == "/tf_static" else buffer.set_transform)(made, "bag")
    placed, projection = [], LaserProjection()
    for _, message in given["/scan"]:
        scan = LaserScan(**{name: value for name, value in message.items() if name not in ("header", "ranges")})
        scan.ranges = [float(value) for value in message["ranges"]]
        points = np.array(list(point_cloud2.read_points(projection.projectLaser(scan), ("x", "y", "z"))))
        try:
            at = buffer.lookup_transform_core("odom", "laser", time_of(message["header"])).transform
        except TransformException as error:
            placed.append(str(error))
            continue
        vector, w = np.array([at.rotation.x, at.rotation.y, at.rotation.z]), at.rotation.w
        points = points.reshape(-1, 3)
        across = 2.0 * np.cross(vector, points)
        points = points + w * across + np.cross(vector, across)
        placed.append((points + [at.translation.x, at.translation.y, at.translation.z]).tolist())
    return placed


def time_of(header):
    return rospy.Time(header["stamp"]["sec"], header["stamp"]["nanosec"])


if __name__ == "__main__":
    print(json.dumps(globals()[sys.argv[1]](*sys.argv[2:])))
