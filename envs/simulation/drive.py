"""What both physics share of a robot's drive: the controller between the commanded twist and the wheels."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from numba import njit

from envs.robots import DriveRecord

from .simulator import Twist

SUBSTEP = 1.0 / 60.0
"""Target duration of one physics step [s]."""


class Timing(NamedTuple):
    """How a control period is cut into physics steps."""

    period: float
    """Control period [s]."""
    substeps: int
    """Number of equal physics steps in it."""


def make_timing(drive: DriveRecord, control_period: float) -> Timing:
    """Cut a control period into physics steps near 1/60 s.

    They are short enough that nothing moves by half the footprint's radius in one of them.

    Raises:
        ValueError: the control period is not positive and finite.
    """
    if not 0.0 < control_period < math.inf:
        raise ValueError(f"control_period must be positive and finite [s], got {control_period}")
    fastest = drive.max_v * drive.wheel_radius / drive.assumed_wheel_radius
    steps = max(1, round(control_period / SUBSTEP), math.ceil(2.0 * control_period * fastest / drive.radius))
    return Timing(float(control_period), steps)


def check_number(num_robots: int, **arguments: Sequence[Any]) -> None:
    """Refuse arguments that do not hold one entry per robot.

    Raises:
        ValueError: names the first of them.
    """
    for name, values in arguments.items():
        if len(values) != num_robots:
            raise ValueError(f"{name} must have one entry per robot, {num_robots} in all, got {len(values)}")


def check_commands(commands: Sequence[Twist]) -> list[tuple[float, float]]:
    """Return the commands as plain floats.

    Raises:
        ValueError: one holds NaN or infinity.
    """
    checked = [(float(v), float(w)) for v, w in commands]
    for v, w in checked:
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ValueError(f"command must be finite, got v = {v} m/s, w = {w} rad/s")
    return checked


@njit(cache=True, error_model="numpy")
def plan_wheels(reached, command, normals, timing, drive, rates, slips):
    """Plan what the wheels do during one control period.

    The command is clipped to the limits, approached at no more than the greatest accelerations, and turned into wheel
    rates by the controller's own idea of the wheels. Each wheel also slips: the variance of the slipped distance
    grows with the distance rolled (Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, equation 5.8).

    Args:
        reached: twist (v, w) that the controller has reached [m/s, rad/s].
        command: commanded twist (v, w) [m/s, rad/s].
        normals: standard normal draws for the slip of the left and the right wheel.
        timing: `Timing`.
        drive: `DriveRecord` of the robot.
        rates: shape (substeps, 2), float64, receives the rates of the left and the right wheel [rad/s].
        slips: shape (substeps, 2), float64, receives the rates that slip adds to the wheel's motion over the ground
            and that encoders do not see [rad/s].

    Returns:
        The twist (v, w) that the controller has reached at the end [m/s, rad/s].
    """
    v, w = reached
    substeps = timing.substeps
    dt = timing.period / substeps
    target_v = min(max(command[0], -drive.max_v), drive.max_v)
    target_w = min(max(command[1], -drive.max_w), drive.max_w)
    change_v, change_w = drive.max_acc_v * dt, drive.max_acc_w * dt
    for i in range(substeps):
        v += min(max(target_v - v, -change_v), change_v)
        w += min(max(target_w - w, -change_w), change_w)
        rates[i, 0] = (v - 0.5 * w * drive.assumed_track) / drive.assumed_wheel_radius
        rates[i, 1] = (v + 0.5 * w * drive.assumed_track) / drive.assumed_wheel_radius
        for wheel in range(2):
            rolled = abs(rates[i, wheel]) * dt * drive.wheel_radius
            slipped = drive.slip_std * math.sqrt(rolled / substeps) * normals[wheel]
            slips[i, wheel] = slipped / (drive.wheel_radius * dt)
    return v, w
