"""The scan, and the robot's own motion."""

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numba import njit

from envs.robot import Robot
from envs.robots import RobotParams
from envs.simulation import records as at

TIME_RANGE = 600.0
"""Time since the reset that is shown as 1 [s]: the same in all worlds, whose time limits tell how large they are."""


@njit(cache=True, error_model="numpy")
def scale_scan(ranges, range_max, scan):
    """Write to `scan` the ranges over the greatest: 1 without a return, 0 for lost beams; both shape (n,), float32."""
    scale = np.float32(1.0 / range_max)
    for k in range(ranges.shape[0]):
        r = ranges[k]
        scan[k] = np.float32(0.0) if math.isnan(r) else min(r * scale, np.float32(1.0))


@njit(cache=True, error_model="numpy")
def scale_scans(ranges, range_max, active, scans):
    """Write the scans of active rows as `scale_scan` does; both shape (n, num_beams), float32."""
    for k in range(ranges.shape[0]):
        if active[k]:
            scale_scan(ranges[k], range_max, scans[k])


class Scan:
    """Ranges over the lidar's greatest range; 1 for no return; 0 for a lost beam or an obstacle that is too near."""

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(0, 1, (num_beams,), float32)`."""
        return spaces.Box(0.0, 1.0, (robot.lidar.num_beams,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the last scan to `out`."""
        scale_scan(robot.reading.ranges, robot.params.lidar.range_max, out)

    def write_rows(self, batch: Any, out: np.ndarray) -> None:
        """Write the last scans of many robots; see `ObservationPart`."""
        scale_scans(batch.ranges, batch.robots[0].params.lidar.range_max, batch.active, out)


@njit(cache=True, error_model="numpy")
def scale_motion(twist, limits, action, bumper, time, out):
    """Write what `Motion` shows to `out`, shape (6,), float32; twist and limits in m/s and rad/s, time in s."""
    out[0] = min(max(twist[0] / limits[0], -1.0), 1.0)
    out[1] = min(max(twist[1] / limits[1], -1.0), 1.0)
    out[2], out[3] = action
    out[4] = bumper
    out[5] = min(time / TIME_RANGE, 1.0)


@njit(cache=True, error_model="numpy")
def scale_motions(rows, limits, active, out):
    """Write the motions of active rows as `scale_motion` does; `out`: shape (n, 6), float32."""
    for k in range(rows.shape[0]):
        if active[k]:
            row = rows[k]
            twist, action = (row[at.TWIST_V], row[at.TWIST_W]), (row[at.ACTION_V], row[at.ACTION_W])
            scale_motion(twist, limits, action, row[at.TOUCHED] > 0.0, row[at.TIME], out[k])


class Motion:
    """How the robot moves, in six numbers.

    Forward speed and yaw rate by odometry over the robot's limits, the last action (2), whether the bumper is pressed
    (0 or 1), and the time since the reset over ten minutes (at most 1).
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (6,), float32)`."""
        return spaces.Box(-1.0, 1.0, (6,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the robot's own motion to `out`."""
        limits, reading = (robot.params.max_v, robot.params.max_w), robot.reading
        scale_motion(tuple(robot.twist), limits, robot.action, reading.bumper, reading.time, out)

    def write_rows(self, batch: Any, out: np.ndarray) -> None:
        """Write the motions of many robots; see `ObservationPart`."""
        params = batch.robots[0].params
        scale_motions(batch.numbers, (params.max_v, params.max_w), batch.active, out)
