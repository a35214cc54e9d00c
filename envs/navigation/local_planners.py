"""Local planners by name."""

from collections.abc import Callable

from envs.files import resolve
from envs.navigation.dwb import DwbPlanner
from envs.navigation.local_planner import LocalPlanner
from envs.navigation.path_follower import PathFollower
from envs.robots import RobotParams

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
