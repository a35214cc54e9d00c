"""Local planners by name."""

from collections.abc import Callable

from baselines.path_follower import PathFollower
from envs.navigation import DwbPlanner, LocalPlanner
from envs.robots import RobotParams

LOCAL_PLANNERS: dict[str, Callable[[RobotParams, float], LocalPlanner]] = {"rpp": PathFollower, "dwb": DwbPlanner}
"""Regulated pure pursuit and DWB; called with the robot and the control period [s]."""


def make_local_planner(name: str, robot: RobotParams, control_period: float) -> LocalPlanner:
    """Return a local planner with its default parameters.

    Raises:
        ValueError: the name is unknown.
    """
    if name not in LOCAL_PLANNERS:
        raise ValueError(f"unknown local planner {name!r}; choose one of {', '.join(LOCAL_PLANNERS)}")
    return LOCAL_PLANNERS[name](robot, control_period)
