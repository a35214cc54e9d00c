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
def plan_wheels(v, w, command_v, command_w, normal_left, normal_right, period, drive, rates, slips):
    """Plan what the wheels do during one control period.

    The command is clipped to the limits, approached at no more than the greatest accelerations, and turned into wheel
    rates by the controller's own idea of the wheels. Each wheel also slips: the variance of the slipped distance
    grows with the distance rolled (Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, equation 5.8).

    Args:
        v: forward speed that the controller has reached [m/s].
        w: yaw rate that the controller has reached [rad/s].
        command_v: commanded forward speed [m/s].
        command_w: commanded yaw rate [rad/s].
        normal_left: standard normal draw for the slip of the left wheel.
        normal_right: the same for the right wheel.
        period: control period [s].
        drive: the robot.
        rates: shape (substeps, 2), float64, receives the rates of the left and the right wheel [rad/s].
        slips: shape (substeps, 2), float64, receives the rates that slip adds to the wheel's motion over the ground
            and that encoders do not see [rad/s].

    Returns:
        The twist (v, w) that the controller has reached at the end [m/s, rad/s].
    """
    substeps = rates.shape[0]
    dt = period / substeps
    target_v = min(max(command_v, -drive.max_v), drive.max_v)
    target_w = min(max(command_w, -drive.max_w), drive.max_w)
    change_v, change_w = drive.max_acc_v * dt, drive.max_acc_w * dt
    for i in range(substeps):
        v += min(max(target_v - v, -change_v), change_v)
        w += min(max(target_w - w, -change_w), change_w)
        rates[i, 0] = (v - 0.5 * w * drive.assumed_track) / drive.assumed_wheel_radius
        rates[i, 1] = (v + 0.5 * w * drive.assumed_track) / drive.assumed_wheel_radius
        for wheel in range(2):
            normal = normal_left if wheel == 0 else normal_right
            rolled = abs(rates[i, wheel]) * dt * drive.wheel_radius
            slipped = drive.slip_std * math.sqrt(rolled / substeps) * normal
            slips[i, wheel] = slipped / (drive.wheel_radius * dt)
    return v, w
