"""A path follower by regulated pure pursuit; see `envs.navigation.pursuit`."""

import math

import numpy as np

from envs.geometry import Pose2D, wrap_angle
from envs.navigation.pursuit import FOLLOWER_FIELDS, FollowerParams, as_record, follow, follower_numbers, turn_rate
from envs.robots import RobotParams
from envs.simulation import Twist


class PathFollower:
    """Drives along one path at a time; a `LocalPlanner`."""

    def __init__(self, robot: RobotParams, control_period: float, params: FollowerParams = FollowerParams()) -> None:
        """Prepare for a robot.

        Args:
            robot: limits and footprint.
            control_period: time between two calls of `command` [s].
            params: how to follow.
        """
        self._goal_tolerance = params.goal_tolerance
        self._numbers = as_record(follower_numbers(robot, control_period, params))[0]
        self._state = np.zeros(1, dtype=FOLLOWER_FIELDS)
        self._state["side"] = 1.0
        self._path = np.empty((0, 2))
        self._heading: float | None = None
        self.blocked = False
        """Whether the last command did not drive on because of obstacles."""

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""
        return self._path[self._state["index"][0] :]

    def set_path(self, path: np.ndarray, heading: float | None = None) -> None:
        """Follow another path from now on; see `LocalPlanner`."""
        self._path = np.ascontiguousarray(path)
        self._heading = heading
        self._state["index"] = 0

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the twist to command for the next period; see `LocalPlanner`."""
        self.blocked = False
        if self._heading is not None and math.hypot(*(self._path[-1] - pose[:2])) <= self._goal_tolerance:
            return self.rotate(wrap_angle(self._heading - pose.theta))
        v, w, self.blocked = follow(self._state[0], self._path, *pose, twist.v, obstacles, self._numbers)
        return Twist(v, w)

    def rotate(self, angle: float) -> Twist:
        """Return the twist that turns on the spot by `angle` [rad], slowing down in time to stop there."""
        return Twist(0.0, turn_rate(angle, self._numbers))
