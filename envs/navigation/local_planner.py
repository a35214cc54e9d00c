"""Local planners: twists that follow a path around obstacles."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from envs.files import resolve
from envs.geometry import Pose2D
from envs.navigation.dwb import DwbPlanner
from envs.navigation.path_follower import PathFollower
from envs.robots import RobotParams
from envs.simulation import Twist


class LocalPlanner(Protocol):
    """Follows one path at a time. Constructed with the robot, the control period and the planner's params.

    Obstacles come in the robot's own frame and not out of a map, so that stops do not depend on the pose
    estimate.
    """

    @property
    def blocked(self) -> bool:
        """Whether the last command did not drive on because of obstacles."""
        ...

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""
        ...

    def set_path(self, path: np.ndarray, heading: float | None = None) -> None:
        """Follow another path from now on.

        Args:
            path: shape (n, 2), n > 0, map frame [m], points about a map cell apart.
            heading: goal heading at the path's end, map frame [rad]; None for any.
        """
        ...

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the twist to command for the next period.

        Args:
            pose: estimated pose of the base, map frame.
            twist: velocity now, by odometry.
            obstacles: shape (n, 2), float64, base frame [m].
        """
        ...


LOCAL_PLANNERS: dict[str, Callable[[RobotParams, float], LocalPlanner]] = {"rpp": PathFollower, "dwb": DwbPlanner}
"""Regulated pure pursuit and DWB; called with the robot and the control period [s]."""


def make_local_planner(name: str, robot: RobotParams, control_period: float) -> LocalPlanner:
    """Return a local planner with its default parameters.

    Args:
        name: one of `LOCAL_PLANNERS`, or `module:attribute` of what is called as those are.
        robot: to drive.
        control_period: time between two calls [s].

    Raises:
        ValueError: the name is unknown.
    """
    planner: LocalPlanner = resolve(name, LOCAL_PLANNERS, "local planner")(robot, control_period)
    return planner
