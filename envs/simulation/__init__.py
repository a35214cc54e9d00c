"""Physics simulation of robots and their sensors."""

from typing import Any

from lidarnaut.envs.robots import RobotParams

from .crowd import Crowd
from .kinematic import KinematicSimulator
from .mover import Mover, Simulator
from .rows import Reading, RobotState, Twist

PHYSICS = ("bullet", "kinematic")


def make_simulator(
    physics: str | type[Mover],
    robot: RobotParams,
    control_period: float,
    num_robots: int = 1,
    crowd: Crowd | None = None,
) -> Any:
    """Create a physics simulator of `num_robots` identical robots.

    `physics`: "kinematic", "bullet" for rigid bodies in PyBullet, or a class. `control_period`: time between commands
    [s].

    Raises:
        ValueError: the physics is unknown, or `control_period` or `num_robots` is out of range.
        ImportError: PyBullet is not installed.
    """
    if num_robots < 1:
        raise ValueError(f"num_robots must be at least 1, got {num_robots}")
    if isinstance(physics, type):
        return physics(robot, control_period, num_robots, crowd)
    if physics == "kinematic":
        return KinematicSimulator(robot, control_period, num_robots, crowd)
    if physics == "bullet":
        from .bullet import BulletSimulator

        return BulletSimulator(robot, control_period, num_robots, crowd)
    raise ValueError(f"unknown physics {physics!r}; choose one of {', '.join(PHYSICS)}")


__all__ = [
    "PHYSICS",
    "Crowd",
    "KinematicSimulator",
    "Mover",
    "Reading",
    "RobotState",
    "Simulator",
    "Twist",
    "make_simulator",
]
