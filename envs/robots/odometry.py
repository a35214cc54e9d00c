"""Wheel odometry: where the robot's own controller thinks it has gone."""

import math

from numba import njit

from envs.geometry import Pose2D

from .params import RobotParams


@njit(cache=True, error_model="numpy")
def wheel_motion(left_ticks, right_ticks, metres_per_tick, track):
    """Return the base's pose after a motion, seen from the base before it, as (x, y, theta) [m, m, rad].

    The two wheels are taken to turn evenly, so that the base moves on a circular arc.

    Args:
        left_ticks: encoder counts of the left wheel during the motion.
        right_ticks: encoder counts of the right wheel during the motion.
        metres_per_tick: how far a wheel rolls in one count [m].
        track: distance between the wheels [m].
    """
    left, right = left_ticks * metres_per_tick, right_ticks * metres_per_tick
    half_turn = 0.5 * (right - left) / track
    distance = 0.5 * (left + right)
    chord = distance * math.sin(half_turn) / half_turn if half_turn != 0.0 else distance
    return chord * math.cos(half_turn), chord * math.sin(half_turn), 2.0 * half_turn


class WheelOdometry:
    """Turns encoder counts into motion, with the wheels as the controller takes them to be."""

    def __init__(self, robot: RobotParams) -> None:
        odometry = robot.odometry
        self.metres_per_tick = 2.0 * math.pi * odometry.wheel_radius / odometry.ticks_per_rev
        """How far a wheel rolls in one count [m]."""
        self._track = odometry.track
        self._ticks = (0, 0)

    def reset(self, ticks: tuple[int, int]) -> None:
        """Start from these cumulative counts of the left and the right wheel."""
        self._ticks = ticks

    def update(self, ticks: tuple[int, int]) -> Pose2D:
        """Return the base's pose now, seen from the base at the last call, from cumulative counts (left, right)."""
        (left_before, right_before), self._ticks = self._ticks, ticks
        return Pose2D(*wheel_motion(ticks[0] - left_before, ticks[1] - right_before, self.metres_per_tick, self._track))
