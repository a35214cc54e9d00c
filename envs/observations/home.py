"""The start of the episode, for robots that are to return to it."""

import math
from collections.abc import Callable

import numpy as np
from gymnasium import spaces

from envs.robot import Robot
from envs.robots import RobotParams

from .goal import GOAL_RANGE


class Home:
    """Where the robot started, in four numbers, by its own estimate.

    1 once the robot is to return and 0 before; distance over 32 m (at most 1), cosine and sine of the bearing.
    """

    def __init__(self, is_returning: Callable[[], bool]) -> None:
        """Take what tells whether the robot is to return."""
        self._is_returning = is_returning

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (4,), float32)`."""
        return spaces.Box(-1.0, 1.0, (4,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write where home is to `out`."""
        to_start = robot.belief.pose.inverse()  # the map frame is the start
        bearing = math.atan2(to_start.y, to_start.x)
        out[0] = self._is_returning()
        out[1] = min(math.hypot(to_start.x, to_start.y) / GOAL_RANGE, 1.0)
        out[2], out[3] = math.cos(bearing), math.sin(bearing)
