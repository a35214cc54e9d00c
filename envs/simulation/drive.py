"""What both physics share of a robot's drive: the controller between the commanded twist and the wheels."""

import math
from typing import NamedTuple

from numba import njit

from envs.robots import RobotParams

from .simulator import Twist

SUBSTEP = 1.0 / 60.0
"""Time that physics aims to advance at once [s]."""


class Drive(NamedTuple):
    """The numbers of `RobotParams` that move the robot, as scalars that Numba takes."""

    max_v: float
    """Greatest forward speed [m/s]."""
    max_w: float
    """Greatest yaw rate [rad/s]."""
    max_acc_v: float
    """Greatest change of forward speed [m/s2]."""
    max_acc_w: float
    """Greatest change of yaw rate [rad/s2]."""
    wheel_radius: float
    """Radius of the wheels [m]."""
    track: float
    """Distance between the wheels [m]."""
    assumed_wheel_radius: float
    """Wheel radius that the controller assumes [m]."""
    assumed_track: float
    """Track that the controller assumes [m]."""
    slip_std: float
    """Standard deviation of the distance that a wheel slips while it rolls 1 m [m]."""
    radius: float
    """Radius of the footprint [m]."""

    @classmethod
    def of(cls, robot: RobotParams) -> "Drive":
        """Collect the numbers of a robot."""
        wheels, assumed = robot.drive, robot.odometry
        return cls(
            float(robot.max_v),
            float(robot.max_w),
            float(robot.max_acc_v),
            float(robot.max_acc_w),
            float(wheels.wheel_radius),
            float(wheels.track),
            float(assumed.wheel_radius),
            float(assumed.track),
            float(wheels.slip_std),
            float(robot.radius),
        )


def count_substeps(drive: Drive, control_period: float) -> int:
    """Return into how many steps of physics a control period is cut.

    Near 1/60 s each, and short enough that nothing moves by half the footprint's radius at once.

    Raises:
        ValueError: the control period is not positive and finite.
    """
    if not 0.0 < control_period < math.inf:
        raise ValueError(f"control_period must be positive and finite [s], got {control_period}")
    fastest = drive.max_v * drive.wheel_radius / drive.assumed_wheel_radius
    return max(1, round(control_period / SUBSTEP), math.ceil(2.0 * control_period * fastest / drive.radius))


def check_command(command: Twist) -> Twist:
    """Return the command as plain floats.

    Raises:
        ValueError: it holds NaN or infinity.
    """
    v, w = float(command[0]), float(command[1])
    if not (math.isfinite(v) and math.isfinite(w)):
        raise ValueError(f"command must be finite, got v = {v} m/s, w = {w} rad/s")
    return Twist(v, w)


@njit(cache=True, error_model="numpy")
def ramp(current, target, limit, max_change):
    """Return `current` moved towards `target` clipped to +-`limit`, by at most `max_change`."""
    target = min(max(target, -limit), limit)
    return current + min(max(target - current, -max_change), max_change)


@njit(cache=True, error_model="numpy")
def wheel_rates(v, w, drive):
    """Return the rates (left, right) [rad/s] at which the controller turns the wheels for a twist, by its own idea
    of their size.
    """  # noqa: D205
    return (
        (v - 0.5 * w * drive.assumed_track) / drive.assumed_wheel_radius,
        (v + 0.5 * w * drive.assumed_track) / drive.assumed_wheel_radius,
    )


@njit(cache=True, error_model="numpy")
def slip(distance, normal, substeps, drive):
    """Return how far a wheel slips in one of `substeps` equal parts of a control period [m].

    Its variance grows with the distance rolled (Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots,
    equation 5.8). One normal draw serves the whole control period.

    Args:
        distance: what the wheel rolls in this part [m].
        normal: standard normal draw of the control period.
        substeps: parts of the control period.
        drive: the robot.
    """
    return drive.slip_std * math.sqrt(abs(distance) / substeps) * normal
