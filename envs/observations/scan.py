"""Observations of the scan, the robot's motion and the robot's limits."""

import math

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.task import RowPart

TIME_RANGE = 600.0
"""Time since the reset that is normalized to 1 [s]; fixed, as time limits would reveal the size of the world."""
SPEED_RANGE = 2.0
"""Robot's maximum forward speed that the observation `Limits` normalizes to 1 [m/s]."""


@njit(cache=True, error_model="numpy")
def scale_scans(ranges, range_max, active, scans):
    """Write ranges / `range_max` (observation `Scan`) of active robots to `scans`, shape (n, num_beams), float32."""
    scale = np.float32(1.0 / range_max)
    for k in range(ranges.shape[0]):
        if active[k]:
            for i in range(ranges.shape[1]):
                r = ranges[k, i]
                scans[k, i] = np.float32(0.0) if math.isnan(r) else min(r * scale, np.float32(1.0))


class Scan(RowPart):
    """Observation of the last scan: `Box(0, 1, (num_beams,), float32)`.

    Ranges / maximum range; 1 is no return, 0 a lost beam or an obstacle too near.
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(0.0, 1.0, (robot.lidar.num_beams,), np.float32)

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        scale_scans(rows.ranges, rows.robots[0].params.lidar.range_max, rows.active, out)


@njit(cache=True, error_model="numpy")
def scale_motions(rows, limits, active, out):
    """Write the observation `Motion` to `out`, shape (n, 6), float32; `active`: robots to write (mask)."""
    for k in range(rows.shape[0]):
        if active[k]:
            row = rows[k]
            out[k, 0] = min(max(row.twist[0] / limits[0], -1.0), 1.0)
            out[k, 1] = min(max(row.twist[1] / limits[1], -1.0), 1.0)
            out[k, 2], out[k, 3], out[k, 4] = row.action_v, row.action_w, row.touched > 0.0
            out[k, 5] = min(row.time / TIME_RANGE, 1.0)


class Limits(RowPart):
    """Observation of the robot's limits, for policies that drive several kinds of robot: `Box(0, 1, (5,), float32)`.

    Maximum forward speed / (2 m/s), yaw rate / (4 rad/s), forward acceleration / (5 m/s2), yaw acceleration / (25
    rad/s2) and footprint radius / 0.5 m, at most 1.
    """

    low, size = 0.0, 5

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        params = rows.robots[0].params
        limits = params.max_v / SPEED_RANGE, params.max_w / 4.0, params.max_acc_v / 5.0, params.max_acc_w / 25.0
        out[:] = np.minimum((*limits, params.radius / 0.5), 1.0)


class Motion(RowPart):
    """Observation of the robot's motion: `Box(-1, 1, (6,), float32)`.

    Forward speed and yaw rate by odometry / maximum speeds, last action (two values), bumper contact (0 or 1), time
    since the reset / 600 s (at most 1).
    """

    size = 6

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        params = rows.robots[0].params
        scale_motions(rows.numbers, (params.max_v, params.max_w), rows.active, out)
