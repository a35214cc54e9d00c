"""Plan of a drive along a route within the robot's limits of speed and acceleration."""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.tasks.route import Route, directions

ROUNDING = 2
"""Steps of the curvature are rounded off over this number of route points to either side."""
LIMIT_SHARE = 0.8
"""Fraction of the robot's maximum yaw rate and accelerations in the plan; the rest is for feedback."""
MIN_SPEED = 0.2
"""Minimum planned speed, at sharp corners, as a fraction of the maximum speed."""
DECAY_LENGTH, MAX_DECAY = 0.3, 0.2
"""Driven distance over which an offset decays [m], and the greatest fraction of the decay in a control period."""

MAX_CORRECTED = 0.05
"""Offset from the route above which the correction does not grow [m], for a small angle of approach."""


class RoutePlan:
    """Path and speeds of a robot along a route.

    The yaw rate cannot jump at the beginning of an arc: the path rounds off steps of the curvature, and the speed is
    low near them.
    """

    def __init__(self, route: Route, robot: RobotParams) -> None:
        around, along = ((ROUNDING, ROUNDING), (0, 0)), route.along
        extended = np.pad(route.points, around, mode="reflect", reflect_type="odd")
        points = sliding_window_view(extended, 2 * ROUNDING + 1, axis=0).mean(axis=-1)
        self.path = Route(points, directions(points), along)
        curvature = np.gradient(np.unwrap(self.path.headings), along)
        with np.errstate(divide="ignore"):
            fastest = LIMIT_SHARE * robot.max_w / abs(curvature)
            # yaw acceleration = squared speed * change of the curvature per metre
            smoothest = np.sqrt(LIMIT_SHARE * robot.max_acc_w / abs(np.gradient(curvature, along)))
        v = np.clip(np.minimum(fastest, smoothest), MIN_SPEED * robot.max_v, robot.max_v)
        braking = 2.0 * LIMIT_SHARE * robot.max_acc_v * along
        self._speeds = np.sqrt(np.minimum.accumulate((v**2 + braking)[::-1])[::-1] - braking)

    def speed(self, along: float) -> float:
        """Return the maximum speed at an arc length [m/s]; includes braking before the next step of the curvature."""
        return float(np.interp(along, self.path.along, self._speeds))

    def turn(self, offset: Pose2D, step: float) -> float:
        """Return the turn of the next control period [rad].

        `offset`: arc length, offset to the left and heading error. `step`: distance to drive [m].
        """
        along, left, turn = offset.x, min(max(offset.y, -MAX_CORRECTED), MAX_CORRECTED), offset.theta
        turn_of_path = wrap_angle(self.path.at(along + step).theta - self.path.at(along).theta)
        decay = min(1.0 / DECAY_LENGTH, MAX_DECAY / max(step, 1e-9))
        return turn_of_path - step * decay * (2.0 * turn + decay * left)


def yaw_rate_for(turn: float, w: float, max_acc_w: float, period: float) -> float:
    """Return the command that turns a robot by `turn` [rad] in a period [s], from a yaw rate `w` [rad/s].

    The yaw rate changes at `max_acc_w` [rad/s2] until it reaches the command.
    """
    rest = turn - w * period
    change = max_acc_w * (period - math.sqrt(max(period**2 - 2.0 * abs(rest) / max_acc_w, 0.0)))
    return w + math.copysign(change, rest)
