"""What stands in the way right now, as a memory of scans in the robot's frame, independent of any map."""

import math

import numpy as np

from envs.navigation.obstacles import BUMP_POINTS, CAPACITY, add_bump, remember, scan_points
from envs.robots import RobotParams


class ObstacleMemory:
    """Obstacles around the robot: the last scan, and what the lidar saw before it came too near or out of view.

    What it remembers moves along by odometry, so that a map which has drifted cannot make the robot blind. Lidars see
    nothing nearer than their least range (0.6 m for the Tugbot, whose front lies within it) or beside their field of
    view.
    """

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        """Prepare for a robot, with nothing remembered.

        Args:
            robot: gives the lidar's geometry and the robot's limits.
            control_period: time between two calls of `update` [s].
        """
        self._robot = robot
        self._period = control_period
        lidar = robot.lidar
        self._cos, self._sin = lidar.directions
        self._points = np.empty((CAPACITY + BUMP_POINTS + lidar.num_beams, 2))
        self._num_remembered = 0
        self._num_points = 0

    def update(self, scan: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Take in an observation and return the obstacles now.

        Args:
            scan: `observation["scan"]`, shape (num_beams,), float32.
            motion: `observation["motion"]`, shape (6,), float32.

        Returns:
            Shape (n, 2), float64, base frame [m]; valid until the next call.
        """
        robot, lidar = self._robot, self._robot.lidar
        distance, dtheta = motion[0] * robot.max_v * self._period, motion[1] * robot.max_w * self._period
        kept = remember(
            self._points,
            self._num_remembered,
            self._num_points,
            distance * math.cos(0.5 * dtheta),
            distance * math.sin(0.5 * dtheta),
            dtheta,
            (lidar.mount.x, lidar.mount.y, lidar.mount.yaw),
            # A full turn has no directions beside its view; a beam's width keeps rounding from making one.
            0.5 * lidar.fov + lidar.angle_increment,
            lidar.range_min,
            2.0 * robot.radius + 0.3,
        )
        if motion[4] > 0.5:
            kept = add_bump(self._points, kept, robot.radius, motion[2] >= 0.0)
        self._num_remembered = kept
        points = self._points[kept:]
        kept += scan_points(scan, 1.0, lidar.range_max, self._cos, self._sin, lidar.mount.x, lidar.mount.y, points)
        self._num_points = kept
        return self._points[:kept]
