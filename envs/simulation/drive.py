"""What both physics share of a robot's drive: the controller between the commanded twist and the wheels."""

import math

from numba import njit

SLIP_MARGIN = 0.5
"""Share of the greatest speed and yaw rate by which slip may move a robot beyond them. It is far from what the robots
of the library slip by: eight standard deviations or more at 20 Hz, five at 50 Hz."""


@njit(cache=True, error_model="numpy")
def plan_wheels(reached, command, normals, robot, rates, slips):
    """Plan what the wheels do during one control period.

    The command is clipped to the limits, approached at no more than the greatest accelerations, and turned into wheel
    rates by the controller's own idea of the wheels. Each wheel also slips: the variance of the slipped distance
    grows with the distance rolled (Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, equation 5.8).
    Rolling and slip together move the base no faster than its limits and `SLIP_MARGIN` allow.

    Args:
        reached: twist (v, w) that the controller has reached [m/s, rad/s].
        command: commanded twist (v, w) [m/s, rad/s].
        normals: standard normal draws for the slip of the left and the right wheel.
        robot: `RobotRecord`.
        rates: shape (substeps, 2), float64, receives the rates of the left and the right wheel [rad/s].
        slips: likewise, receives what slip adds to these over the ground, and encoders do not see [rad/s].

    Returns:
        The twist (v, w) that the controller has reached at the end [m/s, rad/s].
    """
    v, w = reached
    substeps = int(robot.substeps)
    dt = robot.period / substeps
    target_v = min(max(command[0], -robot.max_v), robot.max_v)
    target_w = min(max(command[1], -robot.max_w), robot.max_w)
    change_v, change_w = robot.max_acc_v * dt, robot.max_acc_w * dt
    most_forward = (1.0 + SLIP_MARGIN) * robot.max_v / robot.assumed_wheel_radius
    most_turn = (1.0 + SLIP_MARGIN) * 0.5 * robot.max_w * robot.assumed_track / robot.assumed_wheel_radius
    for i in range(substeps):
        v += min(max(target_v - v, -change_v), change_v)
        w += min(max(target_w - w, -change_w), change_w)
        rates[i, 0] = (v - 0.5 * w * robot.assumed_track) / robot.assumed_wheel_radius
        rates[i, 1] = (v + 0.5 * w * robot.assumed_track) / robot.assumed_wheel_radius
        for wheel in range(2):
            rolled = abs(rates[i, wheel]) * dt * robot.wheel_radius
            slipped = robot.slip_std * math.sqrt(rolled / substeps) * normals[wheel]
            slips[i, wheel] = slipped / (robot.wheel_radius * dt)
        left, right = rates[i, 0] + slips[i, 0], rates[i, 1] + slips[i, 1]
        forward, turn = 0.5 * (left + right), 0.5 * (right - left)
        forward -= min(max(forward, -most_forward), most_forward)  # zero for all usual slip, which is left as it is
        turn -= min(max(turn, -most_turn), most_turn)
        slips[i, 0] -= forward - turn
        slips[i, 1] -= forward + turn
    return v, w
