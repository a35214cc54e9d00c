"""A goal, and the uncertainty of the pose estimate."""

import math
from collections.abc import Callable

import numpy as np
from gymnasium import spaces

from envs.geometry import Pose2D
from envs.robot import Robot
from envs.robots import RobotParams

GOAL_RANGE = 32.0
"""Distance to the goal that is shown as 1 [m]."""


class Goal:
    """Where the goal is, in five numbers, by the robot's own estimate.

    Distance over 32 m (at most 1), cosine and sine of the bearing, cosine and sine of the turn to the goal's heading.
    """

    def __init__(self, goal: Callable[[], Pose2D]) -> None:
        """Take what returns the goal of the moment, map frame."""
        self._goal = goal

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (5,), float32)`."""
        return spaces.Box(-1.0, 1.0, (5,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the goal to `out`."""
        ahead = robot.belief.pose.between(self._goal())
        bearing = math.atan2(ahead.y, ahead.x)
        out[0] = min(math.hypot(ahead.x, ahead.y) / GOAL_RANGE, 1.0)
        out[1], out[2] = math.cos(bearing), math.sin(bearing)
        out[3], out[4] = math.cos(ahead.theta), math.sin(ahead.theta)


class PoseUncertainty:
    """The uncertainty of the pose estimate, in three numbers.

    Standard deviation of the position over 1 m and of the heading over pi (at most 1), and 1 if the estimator is lost.
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(0, 1, (3,), float32)`."""
        return spaces.Box(0.0, 1.0, (3,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the pose's uncertainty to `out`."""
        x, y, theta = np.sqrt(np.diag(robot.belief.covariance)).tolist()
        out[0] = min(math.hypot(x, y), 1.0)
        out[1] = min(theta / math.pi, 1.0)
        out[2] = robot.belief.is_lost
