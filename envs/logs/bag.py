"""Logs as ROS 1 and ROS 2 bags, read without ROS by the library rosbags."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.files import MAX_BYTES
from lidarnaut.envs.geometry import wrap_angle

from .bag_reader import BagError, BagReader, open_bag
from .trajectory import find_jump_back
from .transforms import FrameTree, frame_name, heading, planar_beams

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOM_FRAME = "odom"
"""Frame of odometry by REP 105."""
BASE_FRAMES = ("base_footprint", "base_link")
"""Frames of the base, for odometry that does not say which."""


def is_bag(path: Path) -> bool:
    """Tell whether a path is that of a bag, by its name or by what the folder holds."""
    return path.suffix in (".bag", ".mcap") or (path / "metadata.yaml").is_file()


def read_bag(path: Path, scan_topic: str | None = None, odom_topic: str | None = None) -> dict[str, Any]:
    """Read the scans and the odometry of a bag, as the arrays of `load_log`, with `mount_y`, `mount_z` and `minr`.

    Stamps are those of the messages' headers. Where scans lie between two odometry messages, odometry is interpolated;
    scans before the first or after the last are left out. By REP 117, ranges above `range_max` are no return, and those
    below `range_min` or NaN are ignored. The lidar's mount follows from the transforms between the frame of the scans
    and that of the base, static ones first. Without a topic the only one is taken: of LaserScan messages, and of
    Odometry messages or else of transforms from `odom` to the base.

    Raises:
        BagError: the bag is damaged, a topic is missing or ambiguous, or messages make no sense.
    """
    with open_bag(path) as bag:
        scan_topic = bag.choose([SCAN], scan_topic, "scan_topic")
        scan_times, ranges, scan = _read_scans(bag, scan_topic)
        odom_times, poses, base = _read_odometry(bag, odom_topic)
        mount = _find_mount(bag, base, frame_name(scan.header.frame_id))
    first, step = bag.checked(scan_topic, planar_beams, mount, scan.angle_min, scan.angle_increment)
    if step < 0.0:
        first, step, ranges = first + step * (ranges.shape[1] - 1), -step, ranges[:, ::-1]
    inside = (scan_times >= odom_times[0]) & (scan_times <= odom_times[-1])
    if not inside.any():
        spans = [f"{times[0]:.3f} to {times[-1]:.3f} s" for times in (scan_times, odom_times)]
        raise BagError(f"{path}: scans from {spans[0]} and odometry from {spans[1]} do not overlap")
    times = np.union1d(odom_times, scan_times[inside])
    x, y, theta = poses.T
    columns = [np.interp(times, odom_times, column) for column in (x, y, np.unwrap(theta))]
    return {
        "t": times,
        "odo": np.stack([columns[0], columns[1], wrap_angle(columns[2])], axis=1),
        "idx": np.searchsorted(times, scan_times[inside]),
        "ranges": ranges[inside],
        "ang0": first,
        "dang": step,
        "maxr": scan.range_max,
        "minr": scan.range_min,
        **dict(zip(("mount_x", "mount_y", "mount_z"), mount[:3, 3])),
    }


def _read_scans(bag: BagReader, topic: str) -> tuple[np.ndarray, np.ndarray, Any]:
    """Return times, shape (m,) [s], ranges, shape (m, num_beams), float32 [m], and the first message."""
    times, rows, first = [], [], None
    for number, scan in enumerate(bag.messages(topic)):
        first = scan if first is None else first
        if len(scan.ranges) != len(first.ranges):
            counts = f"{len(scan.ranges)} beams where earlier ones have {len(first.ranges)}"
            raise bag.error(f"{topic}: scan {number} has {counts}")
        ends = [(s.angle_min, s.angle_min + s.angle_increment * (len(s.ranges) - 1)) for s in (scan, first)]
        if not np.abs(np.subtract(ends[0], ends[1])).max() <= 0.5 * abs(first.angle_increment):
            raise bag.error(f"{topic}: scan {number} has beams from {ends[0]} rad, earlier ones from {ends[1]} rad")
        ranges = np.array(scan.ranges, dtype=np.float32)
        ranges[(ranges < scan.range_min) | (ranges <= 0.0)] = np.nan
        rows.append(ranges)
        if (size := len(rows) * ranges.nbytes) > MAX_BYTES:
            raise bag.error(f"{topic}: unpacks to {size:,} bytes; at most {MAX_BYTES:,} are allowed")
        times.append(_seconds(scan.header.stamp))
    order = _time_order(bag, topic, times)
    return np.array(times)[order], np.stack(rows)[order], first


def _read_odometry(bag: BagReader, topic: str | None) -> tuple[np.ndarray, np.ndarray, str]:
    """Return times, ascending, shape (n,) [s], poses, shape (n, 3) [m, m, rad], and the base's frame, perhaps empty."""
    moving = [name for name in bag.topics(TRANSFORMS) if not name.endswith("tf_static")]
    if topic is None and len(moving) == 1 and not bag.topics([ODOMETRY]):
        topic = moving[0]
    topic = bag.choose([ODOMETRY] if topic is None else [ODOMETRY, *TRANSFORMS], topic, "odom_topic")
    times, poses, bases = [], [], set()
    for stamp, position, rotation, base in _poses(bag, topic):
        times.append(_seconds(stamp))
        poses.append((position.x, position.y, bag.checked(f"{topic} at {times[-1]:.3f} s", heading, rotation)))
        bases.add(frame_name(base))
        if not np.isfinite(poses[-1]).all():
            raise bag.error(f"{topic}: pose ({position.x}, {position.y}) m at {times[-1]:.3f} s is not finite")
    if not times:
        raise bag.error(f"{topic} holds no transform from {ODOM_FRAME}")
    if len(bases) > 1:
        raise bag.error(f"{topic} holds odometry of several frames: {', '.join(sorted(bases))}")
    order = _time_order(bag, topic, times)
    return np.array(times)[order], np.array(poses)[order], bases.pop()


def _poses(bag: BagReader, topic: str) -> Iterator[tuple[Any, Any, Any, str]]:
    """Yield stamp, position, orientation and frame of the base of each pose by odometry."""
    for message in bag.messages(topic):
        if bag.types[topic] == ODOMETRY:
            pose = message.pose.pose
            yield message.header.stamp, pose.position, pose.orientation, message.child_frame_id
            continue
        for one in message.transforms:
            if frame_name(one.header.frame_id).rpartition("/")[2] == ODOM_FRAME:
                yield one.header.stamp, one.transform.translation, one.transform.rotation, one.child_frame_id


def _find_mount(bag: BagReader, base: str, frame: str) -> np.ndarray:
    """Return the pose of the lidar in the base frame, shape (4, 4); where none is known, that of the base itself."""
    tree = FrameTree()
    # Static transforms alone lead there in most bags, and those of /tf are many.
    topics = sorted(bag.topics(TRANSFORMS), key=lambda topic: not topic.endswith("tf_static"))
    for topic in topics:
        for message in bag.messages(topic):
            bag.checked(topic, tree.add, message.transforms)
        for start in (base,) if base else BASE_FRAMES:
            mount = tree.find(start, frame)
            if mount is not None:
                return mount
    if frame != base:
        text = "%s: no transforms from %r to %r; the lidar is taken to sit on the base, facing ahead"
        logging.getLogger(__name__).warning(text, bag.path, base, frame)
    return np.eye(4)


def _time_order(bag: BagReader, topic: str, times: list[float]) -> np.ndarray:
    """Return the order of stamps that ascend but for small jumps; where the clock runs back there is none."""
    jump = find_jump_back(np.array(times))
    if jump is not None:
        clock = f"from {max(times[:jump]):.3f} to {times[jump]:.3f} s"
        raise bag.error(f"{topic}: the clock runs back {clock} at message {jump}")
    if len(times) > 1 and min(times) == max(times):
        raise bag.error(f"{topic}: all messages have the stamp {times[0]:.3f} s")
    return np.argsort(times, kind="stable")


def _seconds(stamp: Any) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec
