"""Lidar that spins: each beam is measured at its own time, while robot and people move."""

import math
from collections import deque

import numpy as np
from numba import njit

from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.robots import LidarParams

from . import records as at
from .sensors import OTHER_NORMALS, disturb_ranges, tilt_ranges, with_peers

GROUP = 8
"""Number of beams with one lidar position; the lidar turns between them."""


@njit(cache=True, error_model="numpy")
def sweep_ranges(poses, instants, draws, robot, segments, circles, ranges):
    """Simulate a noisy scan whose beams are measured one after the other.

    Args:
        poses: base pose (x, y, theta) at each beam, world frame, shape (num_beams, 3) [m, m, rad].
        instants: time of each beam, as an index into `circles`, shape (num_beams,), float64.
        draws: random numbers for noise, as in `disturb_ranges`.
        robot: `RobotRecord`.
        segments: walls (x0, y0, x1, y1), shape (n, 4), float64 [m].
        circles: obstacles and people (x, y, radius) at successive times, shape (k, m, 3), float64 [m].
        ranges: output, shape (num_beams,), float32 [m].
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
    """Simulated lidars that spin, of all robots of a world.

    The last beam of each scan is measured at the end of a control period. Poses are linear between control periods.
    """

    def __init__(self, lidar: LidarParams, control_period: float) -> None:
        """Create a lidar that turns in `lidar.scan_time`."""
        ages = lidar.time_increment * np.arange(lidar.num_beams)[::-1] / control_period
        self._count = max(math.ceil(ages[0]), 1) + 1
        self._instants = self._count - 1 - ages
        self._paths: deque[np.ndarray] = deque(maxlen=self._count)
        self._circles: deque[list[np.ndarray]] = deque(maxlen=self._count)

    def measure(
        self, rows: np.ndarray, draws: np.ndarray, ranges: np.ndarray, segments: np.ndarray, circles: np.ndarray
    ) -> np.ndarray:
        """Replace the scans of a control period; return the base poses by odometry at their ends and at each beam.

        `rows`, `draws`, `ranges`, `segments`, `circles`: as in `sense`. Poses have shape (num_robots, 1 + num_beams, 3)
        [m, m, rad].
        """
        robot = at.unpack_robot(rows[0, at.ROBOT :])
        path = np.concatenate([rows[:, at.X : at.THETA + 1], rows[:, at.ODOMETRY_POSE : at.ODOMETRY_POSE + 3]], axis=1)
        circles_seen = [with_peers(circles, rows, k, robot.radius) for k in range(len(rows))]
        if rows[0, at.STEPS] == 0.0:
            self._paths.extend([path] * self._count)  # at rest before the reset
            self._circles.extend([circles_seen] * self._count)
        else:
            turns = np.stack([robot.period * rows[:, at.MEAN_W], rows[:, at.ODOMETRY + 2]], axis=1)
            last = self._paths[-1][:, [2, 5]] + turns
            path[:, [2, 5]] += 2.0 * math.pi * np.rint((last - path[:, [2, 5]]) / (2.0 * math.pi))
            self._paths.append(path)
            self._circles.append(circles_seen)
        times, paths = np.arange(self._count), np.array(self._paths)
        poses = np.empty((len(rows), 1 + len(self._instants), 3))
        for k, row in enumerate(rows):
            beams = np.stack([np.interp(self._instants, times, column) for column in paths[:, k].T], axis=1)
            noise, visible = draws[k, int(row[at.DRAW]), OTHER_NORMALS:], np.stack([each[k] for each in self._circles])
            sweep_ranges(beams[:, :3].copy(), self._instants, noise, robot, segments, visible, ranges[k])
            poses[k, 0], poses[k, 1:] = paths[-1, k, 3:], beams[:, 3:]
        return poses
