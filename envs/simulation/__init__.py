"""Two physics for one robot, and its sensors."""

from envs.robots import RobotParams

from .kinematic import KinematicSimulator
from .simulator import Reading, Simulator, TrueState, Twist

PHYSICS = ("bullet", "kinematic")
"""Names of the physics."""


def make_simulator(physics: str, robot: RobotParams, control_period: float) -> Simulator:
    """Return a robot under the named physics.

    Args:
        physics: one of `PHYSICS`.
        robot: the robot.
        control_period: time between two commands [s].

    Raises:
        ValueError: the physics is unknown, or the control period is not positive.
        ImportError: bullet is asked for where PyBullet is not installed.
    """
    if physics == "kinematic":
        return KinematicSimulator(robot, control_period)
    if physics == "bullet":
        from .bullet import BulletSimulator

        return BulletSimulator(robot, control_period)
    raise ValueError(f"unknown physics {physics!r}; choose one of {', '.join(PHYSICS)}")


__all__ = ["PHYSICS", "KinematicSimulator", "Reading", "Simulator", "TrueState", "Twist", "make_simulator"]
