"""The route ahead."""

from collections.abc import Callable

import numpy as np
from gymnasium import spaces

from envs.robot import Robot
from envs.robots import RobotParams

NUM_POINTS = 10
"""Points of the route that are shown."""
SPACING = 0.4
"""Distance between them [m]."""
SCALE = 5.0
"""Distance that is shown as 1 [m]."""


class RouteAhead:
    """Points of the route 0, 0.4, ... 3.6 m ahead, as (forward, left) of the estimated pose, over 5 m."""

    def __init__(self, points_ahead: Callable[[np.ndarray], np.ndarray]) -> None:
        """Take what returns the points, shape (n, 2), map frame [m], at distances ahead, shape (n,) [m]."""
        self._points_ahead = points_ahead

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (10, 2), float32)`."""
        return spaces.Box(-1.0, 1.0, (NUM_POINTS, 2), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the points to `out`."""
        ahead = robot.belief.pose.inverse().transform(self._points_ahead(SPACING * np.arange(NUM_POINTS)))
        np.clip(ahead / SCALE, -1.0, 1.0, out=out, casting="same_kind")
