"""Lidar that spins: each beam is measured at its own time, while robot and people move."""

import math
from collections import deque
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.geometry.scan_resampling import resample_scan
from lidarnaut.envs.robots import LidarParams

from .records import unpack_robot
from .sensors import OTHER_NORMALS, disturb_ranges, tilt_ranges, with_peers

GROUP = 8
"""Number of beams with one lidar position; the lidar turns between them."""


@njit(cache=True, error_model="numpy")
def sweep_ranges(poses, instants, draws, robot, segments, circles, ranges):
    """Simulate a noisy scan whose beams are measured one after the other.

    `poses`: base pose at each beam, world frame, shape (num_beams, 3) [m, m, rad]. `circles`: obstacles and people (x,
    y, radius) at successive times, shape (k, m, 3) [m]. `instants`: time of each beam, as an index into `circles`,
    shape (num_beams,), float64. Other arguments as in `measure_ranges`.
    """
    num_beams, step = ranges.shape[0], robot.angle_increment
    for first in range(0, num_beams, GROUP):
        last = min(first + GROUP, num_beams)
        middle = (first + last) // 2
        before = min(int(instants[middle]), circles.shape[0] - 2)
        visible = circles[before] + (instants[middle] - before) * (circles[before + 1] - circles[before])
        c, s = math.cos(poses[middle, 2]), math.sin(poses[middle, 2])
        x = poses[middle, 0] + c * robot.mount_x - s * robot.mount_y
        y = poses[middle, 1] + s * robot.mount_x + c * robot.mount_y
        turn = (poses[last - 1, 2] - poses[first, 2]) / max(last - 1 - first, 1)
        beams = Beams(robot.angle_min + first * step, max(step + turn, 0.01 * step), robot.range_max)
        cast_rays(x, y, poses[first, 2] + robot.mount_yaw, beams, segments, visible, ranges[first:last])
    if robot.mount_pitch != 0.0 or robot.mount_roll != 0.0:
        tilt_ranges(ranges, robot)
    disturb_ranges(ranges, draws, robot)


class SpinningLidar:
    """Lidars that spin, of all robots of a world; the last beam of a scan is measured at the end of a control period.

    Poses, and positions of people, are linear between the ends of control periods.
    """

    def __init__(self, lidar: LidarParams, control_period: float) -> None:
        ages = lidar.time_increment * np.arange(lidar.num_beams)[::-1] / control_period
        self._lidar, self._count = lidar, max(math.ceil(ages[0]), 1) + 1
        self._instants = self._count - 1 - ages
        self._paths: deque[np.ndarray] = deque(maxlen=self._count)
        self._circles: deque[list[np.ndarray]] = deque(maxlen=self._count)

    def measure(self, rows: Any, segments: np.ndarray, circles: np.ndarray, *, deskews: bool) -> None:
        """Replace the scans of a control period; with `deskews`, correct them for the motion by odometry.

        `rows`: `Rows` of the robots. `segments`, `circles`: as in `sense`.
        """
        numbers, lidar = rows.numbers, self._lidar
        robot = unpack_robot(numbers[0])
        path = np.column_stack([numbers["x"], numbers["y"], numbers["theta"], numbers["odometry_pose"]])
        seen = [with_peers(circles, numbers, k, robot.radius) for k in range(len(numbers))]
        if numbers["steps"][0] == 0.0:  # at rest before the reset
            self._paths.extend([path] * self._count)
            self._circles.extend([seen] * self._count)
        turns = np.stack([robot.period * numbers["mean_w"], numbers["odometry"][:, 2]], axis=1)
        last = self._paths[-1][:, [2, 5]] + turns
        path[:, [2, 5]] += 2.0 * math.pi * np.rint((last - path[:, [2, 5]]) / (2.0 * math.pi))
        self._paths.append(path)
        self._circles.append(seen)
        times, paths, mount = np.arange(self._count), np.array(self._paths), (lidar.mount.x, lidar.mount.y)
        angles = lidar.angles + lidar.mount.yaw
        for k, (row, ranges) in enumerate(zip(numbers, rows.ranges)):
            poses = np.stack([np.interp(self._instants, times, column) for column in paths[:, k].T], axis=1)
            noise, visible = rows.draws[k, int(row["draw"]), OTHER_NORMALS:], [one[k] for one in self._circles]
            sweep_ranges(poses[:, :3].copy(), self._instants, noise, robot, segments, np.stack(visible), ranges)
            if deskews:
                odometry, beams = np.vstack([path[k], poses])[:, 3:], (angles[0], lidar.angle_increment, len(angles))
                ranges[:] = resample_scan(ranges, angles, mount, mount, beams, odometry)
