"""ROS 2 messages of sensor data, estimates and commands (REP 105, REP 117), with stamps of a ROS clock [s]."""

import functools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.robots import LidarParams, Mount
from lidarnaut.envs.simulation import Twist

MAP, ODOM, BASE, BASE_LINK, LASER = "map", "odom", "base_footprint", "base_link", "laser"
"""Names of ROS frames. `base_link` coincides with `base_footprint`."""
RESET_STAMP = 1.0
"""ROS time of the reset in bags and of simulated robots [s]: for `tf2`, the stamp 0 means the latest transform."""


@functools.cache
def typestore() -> Any:
    """Return the ROS 2 message types (Humble and later)."""
    return get_typestore(Stores.ROS2_JAZZY)


def clock(time: float) -> Any:
    """Return a `rosgraph_msgs/Clock` message."""
    return _make("rosgraph_msgs/msg/Clock", _stamp(time))


def laser_scan(time: float, ranges: np.ndarray, lidar: LidarParams, period: float, time_increment: float = 0.0) -> Any:
    """Return a `sensor_msgs/LaserScan` of ranges, shape (num_beams,), float32 [m].

    `time`: that of the first beam [s]; `time_increment`: time between beams [s]; `period`: time between scans [s].
    """
    first, last = lidar.angles[[0, -1]].tolist()
    limits = (lidar.range_min, lidar.range_max)
    no_intensities = np.array([], dtype=np.float32)
    beams = (first, last, lidar.angle_increment, time_increment, period, *limits)
    return _make("sensor_msgs/msg/LaserScan", _header(time, LASER), *beams, ranges, no_intensities)


def odometry(time: float, pose: Pose2D, twist: Twist) -> Any:
    """Return a `nav_msgs/Odometry` with a base pose in the odometry frame; covariances are zero (unknown)."""
    unknown = np.zeros(36)
    with_covariance = _make("geometry_msgs/msg/PoseWithCovariance", _pose(pose), unknown)
    velocity = _make("geometry_msgs/msg/TwistWithCovariance", _twist(twist), unknown)
    return _make("nav_msgs/msg/Odometry", _header(time, ODOM), BASE, with_covariance, velocity)


def imu(time: float, yaw_rate: float) -> Any:
    """Return a `sensor_msgs/Imu` with a yaw rate [rad/s]; orientation and acceleration are unknown (-1)."""
    no_vector, unknown, zeros = _make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), np.zeros(9), np.zeros(9)
    unknown[0] = -1.0
    rate = _make("geometry_msgs/msg/Vector3", 0.0, 0.0, yaw_rate)
    parts = _quaternion(0.0), unknown, rate, zeros, no_vector, unknown
    return _make("sensor_msgs/msg/Imu", _header(time, BASE_LINK), *parts)


def transforms(time: float, *edges: tuple[str, str, Pose2D]) -> Any:
    """Return a `tf2_msgs/TFMessage` of transforms: parent frame, child frame, and pose of the child in the parent."""
    made = []
    for parent, child, (x, y, theta) in edges:  # without the limits of a lidar's mount: odometry may be far away
        made.append(_transform(time, parent, child, SimpleNamespace(x=x, y=y, z=0.0, roll=0.0, pitch=0.0, yaw=theta)))
    return _make("tf2_msgs/msg/TFMessage", made)


def static_transforms(mount: Mount) -> Any:
    """Return a `tf2_msgs/TFMessage` with the static transforms from base to base link and lidar."""
    edges = [_transform(RESET_STAMP, BASE, BASE_LINK, Mount()), _transform(RESET_STAMP, BASE_LINK, LASER, mount)]
    return _make("tf2_msgs/msg/TFMessage", edges)


def occupancy_grid(time: float, grid: OccupancyGrid) -> Any:
    """Return a map as a `nav_msgs/OccupancyGrid` message."""
    height, width = grid.data.shape
    corner = _pose(Pose2D(*grid.origin, 0.0))
    info = _make("nav_msgs/msg/MapMetaData", _stamp(time), grid.resolution, width, height, corner)
    return _make("nav_msgs/msg/OccupancyGrid", _header(time, MAP), info, grid.data.ravel())


def path(time: float, points: np.ndarray) -> Any:
    """Return a `nav_msgs/Path` through points, shape (n, 2), map frame [m]."""
    steps = np.diff(points, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    poses = [
        _make("geometry_msgs/msg/PoseStamped", _header(time, MAP), _pose(Pose2D(float(x), float(y), float(theta))))
        for (x, y), theta in zip(points, [*headings, *headings[-1:]] or [0.0] * len(points))
    ]
    return _make("nav_msgs/msg/Path", _header(time, MAP), poses)


def command(time: float, twist: Twist, frame: str = BASE) -> Any:
    """Return a velocity command as a `geometry_msgs/TwistStamped`, as Nav2 publishes on `cmd_vel`."""
    return _make("geometry_msgs/msg/TwistStamped", _header(time, frame), _twist(twist))


def points(time: float, positions: np.ndarray) -> Any:
    """Return a `visualization_msgs/MarkerArray` of points, shape (n, 2), map frame [m], for 2.5 s."""
    shown = [_make("geometry_msgs/msg/Point", x, y, 0.0) for x, y in positions.tolist()]
    kind = typestore().types["visualization_msgs/msg/Marker"].POINTS
    return _make(
        "visualization_msgs/msg/MarkerArray",
        [_marker(time, "points", 0, kind, Pose2D(0.0, 0.0, 0.0), (0.1, 0.1, 0.1), shown, 2.5)],
    )


def people(time: float, states: np.ndarray) -> Any:
    """Return a `visualization_msgs/MarkerArray` of people: cylinders with velocity arrows, visible for 0.5 s.

    `states`: x, y, vx, vy, radius, shape (n, 5), map frame [m, m/s].
    """
    kinds, markers = typestore().types["visualization_msgs/msg/Marker"], []
    for k, (x, y, vx, vy, radius) in enumerate(states.tolist()):
        arrow = [_make("geometry_msgs/msg/Point", *point, 0.1) for point in ((x, y), (x + vx, y + vy))]
        size = 2.0 * radius, 2.0 * radius, 0.2
        markers.append(_marker(time, "people", k, kinds.CYLINDER, Pose2D(x, y, 0.0), size, []))
        markers.append(_marker(time, "velocities", k, kinds.ARROW, Pose2D(0.0, 0.0, 0.0), (0.05, 0.1, 0.1), arrow))
    return _make("visualization_msgs/msg/MarkerArray", markers)


def numbers(values: np.ndarray) -> Any:
    """Return an array as a `std_msgs/Float64MultiArray` message."""
    dimension = functools.partial(_make, "std_msgs/msg/MultiArrayDimension", "")
    sizes = [dimension(size, math.prod(values.shape[k:])) for k, size in enumerate(values.shape)]
    layout = _make("std_msgs/msg/MultiArrayLayout", sizes, 0)
    return _make("std_msgs/msg/Float64MultiArray", layout, np.asarray(values, dtype=np.float64).ravel())


def _make(kind: str, *fields: Any) -> Any:
    return typestore().types[kind](*fields)


def _stamp(time: float) -> Any:
    seconds, nanoseconds = divmod(round(time * 1e9), 10**9)
    return _make("builtin_interfaces/msg/Time", seconds, nanoseconds)


def _header(time: float, frame: str) -> Any:
    return _make("std_msgs/msg/Header", _stamp(time), frame)


def _pose(pose: Pose2D) -> Any:
    point = _make("geometry_msgs/msg/Point", pose.x, pose.y, 0.0)
    return _make("geometry_msgs/msg/Pose", point, _quaternion(pose.theta))


def _twist(twist: Twist) -> Any:
    vectors = [_make("geometry_msgs/msg/Vector3", *values) for values in ((twist.v, 0.0, 0.0), (0.0, 0.0, twist.w))]
    return _make("geometry_msgs/msg/Twist", *vectors)


def _marker(
    time: float, name: str, k: int, kind: int, pose: Pose2D, size: Any, points: Any, lifetime: float = 0.5
) -> Any:
    header, nothing = _header(time, MAP), np.array([], dtype=np.uint8)
    add = typestore().types["visualization_msgs/msg/Marker"].ADD
    look = _make("geometry_msgs/msg/Vector3", *size), _make("std_msgs/msg/ColorRGBA", 0.9, 0.6, 0.0, 0.8)
    seconds, fraction = divmod(lifetime, 1.0)
    shown = _make("builtin_interfaces/msg/Duration", int(seconds), round(fraction * 1e9))
    texture = _make("sensor_msgs/msg/CompressedImage", header, "", nothing)
    mesh = _make("visualization_msgs/msg/MeshFile", "", nothing)
    rest: Any = False, points, [], "", texture, [], "", "", mesh, False
    return _make("visualization_msgs/msg/Marker", header, name, k, kind, add, _pose(pose), *look, shown, *rest)


def _transform(time: float, parent: str, child: str, mount: Any) -> Any:
    translation = _make("geometry_msgs/msg/Vector3", mount.x, mount.y, mount.z)
    transform = _make("geometry_msgs/msg/Transform", translation, _quaternion(mount.yaw, mount.pitch, mount.roll))
    return _make("geometry_msgs/msg/TransformStamped", _header(time, parent), child, transform)


def _quaternion(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Any:
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in (yaw, pitch, roll))
    x, y = cy * cp * sr - sy * sp * cr, cy * sp * cr + sy * cp * sr
    return _make("geometry_msgs/msg/Quaternion", x, y, sy * cp * cr - cy * sp * sr, cy * cp * cr + sy * sp * sr)
