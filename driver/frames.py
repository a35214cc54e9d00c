"""Frames of a robot's messages: base frame, mounts of sensors, and scans that wait for their transform, as in tf2."""

import logging
import math
from collections import deque
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.logs.bag import BASE_FRAMES
from lidarnaut.envs.logs.scans import (
    MAX_RANGE_LIMIT,
    Limits,
    Scan,
    in_base_frame,
    scan_of,
    usable_scans,
    with_checked_times,
)
from lidarnaut.envs.logs.transforms import MIN_UPRIGHT, FrameTree, frame_name, planar
from lidarnaut.envs.robots import LidarParams

from .rosbridge import said_once

LOGGER = logging.getLogger(__name__)
MAX_WAITING, MAX_TRANSFORMS = 20, 1000
"""Maximum numbers of scans that wait for a transform, and of transforms per pair of frames."""
WAIT_FOR_TREE, WAIT_FOR_TRANSFORM = 3.0, 5.0
"""Time without any transform until the robot YAML places sensors, and without that of a sensor until a warning [s]."""
SAME_MOUNT = 0.05
"""Maximum difference of mounts that count as equal [m, rad]."""
NEGLIGIBLE = 1e-6
"""Components of an angular velocity with smaller weights are not used, and may be invalid."""
FAULTS = {
    "scans": "scans wait: no transform from {!r} (--base-frame) to {!r}; "
    "--lidar-from-robot uses that of the robot YAML",
    "IMU": "the IMU is not used: no fixed transform from {!r} to {!r}",
    "odometry": "odometry is not used: no fixed transform from {!r} to --base-frame {!r}",
}
DEFAULTS = {"scans": "the mount of the robot YAML is used", "IMU": "the IMU counts as upright"}


class Frames:
    """Transforms of a robot, and scans that wait for theirs. Times `now` are those of the robot's clock [s]."""

    def __init__(self, options: Any, lidar: LidarParams) -> None:
        """Begin without transforms. `options`: those of `lidarnaut.driver.drive`; `lidar`: that of the robot YAML."""
        self.map, self.odom = frame_name(options.map_frame), frame_name(options.odom_frame)
        self.base, self.laser = frame_name(options.base_frame), frame_name(options.laser_frame)
        """Names of base and lidar frame; empty while unknown."""
        self._options, self._lidar, self._has_default, self._is_late = options, lidar, False, False
        self._warn = said_once(LOGGER.warning)
        self._mount, mount = np.eye(4), lidar.mount
        self._mount[:3, :3] = Rotation.from_euler("z", mount.yaw).as_matrix()
        self._mount[:3, 3] = mount.x, mount.y, mount.z
        self._tree, self._has_tree = FrameTree(MAX_TRANSFORMS), False
        self._fixed: dict[tuple[str, str], np.ndarray] = {}
        self._waiting = deque[Scan](maxlen=MAX_WAITING)
        self._stamp, self._began = -math.inf, dict[str, float]()

    def add(self, message: Any, *, static: bool) -> None:
        """Add the transforms of a TFMessage; those of localization and odometry do not place sensors."""
        for one in message.transforms:
            try:
                parent = frame_name(one.header.frame_id)
                self._has_tree |= static or parent != self.map
                if static or parent not in (self.map, self.odom):
                    self._fixed.clear()
                    self._tree.add(one, static)
            except (AttributeError, TypeError, ValueError, OverflowError) as error:  # the others count, as in tf2
                self._warn(f"the transform of frame {getattr(one, 'child_frame_id', None)!r} is ignored: {error}")

    def is_expected(self, what: str, given: str | None, frame: str) -> bool:
        """Return whether messages are of a frame, or of none; otherwise give a warning."""
        if (given := frame_name(given)) in ("", frame):
            return True
        self._warn(f"{what}: messages of frame {given!r} are ignored, expected {frame!r}; see the options of frames")
        return False

    def base_pose(self, child: str | None, pose: Pose2D, now: float) -> Pose2D | None:
        """Return the base pose, given the pose of odometry's child frame; None if they are not connected."""
        child = frame_name(child)
        if not self._options.base_frame:
            if not (self.base or child) and (names := set(BASE_FRAMES) & set(self._tree.frames)):
                child = min(names, key=BASE_FRAMES.index)
                self._warn(f"odometry has no child_frame_id: {child!r} of the transforms is the base")
            self.base = self.base or child
            return pose if self.is_expected("odometry", child, self.base) else None
        if child in ("", self.base):
            return pose
        shift = self._find("odometry", child, self.base, math.inf, now)
        return None if shift is None else pose.compose(Pose2D(*planar(shift[None])[0].tolist()))

    def yaw_rate(self, message: Any, now: float) -> float | None:
        """Return the yaw rate of the base by an Imu message [rad/s]; None if its mount is unknown."""
        mount = self._find("IMU", self.base, frame_name(message.header.frame_id), math.inf, now, np.eye(4))
        if mount is None:
            return None
        rate, weights = message.angular_velocity, mount[2, :3]
        is_used = abs(weights) > NEGLIGIBLE
        return float(weights[is_used] @ np.array([rate.x, rate.y, rate.z], dtype=np.float64)[is_used])

    def receive(self, message: Any) -> None:
        """Receive a scan, which waits for its transform."""
        frame = frame_name(message.header.frame_id)
        self.laser = self.laser or frame
        if not self.is_expected("scans", frame, self.laser):
            return
        null = math.nan if self._options.no_return == "nan" else math.inf
        scan = self._with_limits(scan_of(message, null))
        interval, self._stamp = scan.time - self._stamp, scan.time
        checked = with_checked_times(scan, interval if interval > 0.0 else math.inf)
        if checked is not scan:
            beam = f"{scan.time_increment:g} s for each of {len(scan.ranges)} beams"
            self._warn(f"time_increment of scans is ignored: {beam}, but {interval:.3g} s between scans")
        self._waiting.append(checked)

    def placed(self, now: float) -> list[Scan]:
        """Return the waiting scans whose transform is known, in the base frame, oldest first."""
        placed: list[Scan] = []
        while self._waiting:
            mount: np.ndarray | None = self._mount
            if not self._options.lidar_from_robot:
                mount = self._find("scans", self.base, self.laser, self._waiting[0].time, now, self._mount)
            if mount is None:
                break
            if self._has_default and not np.allclose(mount[:2], self._mount[:2], rtol=0.0, atol=SAME_MOUNT):
                self._warn("the lidar's transform is late, and not the mount used so far: restart")
                self._is_late = True
                break
            self._has_default |= mount is self._mount
            placed += self._usable(self._waiting.popleft(), mount)
        return placed

    def explain(self, reason: str) -> str:
        """Return the reason of a stop, and what scans wait for."""
        if not (self._waiting and reason.startswith("no scan")):
            return reason
        wanted = f"a transform from {self.base!r} to {self.laser!r}"
        if not self.base:
            wanted = "odometry with a child frame, or --base-frame"
        return f"{reason} (scans wait for {'a restart' if self._is_late else wanted})"

    def _find(
        self, what: str, base: str, frame: str, time: float, now: float, default: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Return the pose of a frame in another one, shape (4, 4); `default` without any transforms; None if unknown.

        At the time inf, only transforms that do not vary are known.
        """
        pose = self._fixed.get((base, frame))
        if pose is None and base and (found := self._tree.find(base, frame, np.array([time, math.inf]))) is not None:
            if np.isfinite(found[1]).all():
                self._fixed[base, frame] = found[1]
            pose = found[0] if np.isfinite(found[0]).all() else None
        if pose is not None:
            self._began.pop(what, None)
            return pose
        began = self._began.get(what, math.inf)
        if not began <= now:  # not waited yet, or the clock has stepped back
            began = self._began[what] = now
        if default is not None and not self._has_tree and now - began >= WAIT_FOR_TREE:
            self._warn(f"there are no transforms on /tf_static: {DEFAULTS[what]}")
            return default
        if now - began >= WAIT_FOR_TRANSFORM:
            frames = [f"{name!r} (invalid)" if name in self._tree.ignored else repr(name) for name in self._tree.frames]
            fault = FAULTS[what].format(base, frame)
            self._warn(f"{fault}; frames with transforms: {', '.join(frames) or 'none'}")
        return None

    def _usable(self, scan: Scan, mount: np.ndarray) -> list[Scan]:
        """Return the scan in the base frame, with counter-clockwise beams; none, and a warning, if it is unusable."""
        try:
            if (upright := abs(mount[2, 2])) < MIN_UPRIGHT:
                tilt = math.degrees(math.acos(upright))
                raise ValueError(f"scans are dropped: the lidar is tilted by {tilt:.0f} degrees")
            return usable_scans([in_base_frame(scan, mount)], Limits())[0]
        except ValueError as error:
            self._warn(str(error))
            return []

    def _with_limits(self, scan: Scan) -> Scan:
        """Return a scan with the range limits of the robot YAML for invalid ones."""
        low, high = given = scan.range_min, scan.range_max
        if not 0.0 < high <= MAX_RANGE_LIMIT:
            high = min(self._lidar.range_max, MAX_RANGE_LIMIT)
        if not 0.0 < low < high:
            low = self._lidar.range_min
        if not low < high:  # limits that were swapped
            high = self._lidar.range_max
        if (low, high) != given:
            used = f"those from {low:g} to {high:g} m are used"
            self._warn(f"scans have ranges from {given[0]:g} to {given[1]:g} m: {used}")
        return scan._replace(range_min=low, range_max=high)
