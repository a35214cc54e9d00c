"""Wheel odometry: where the robot's own controller thinks it has gone."""

import math

from envs.geometry import Pose2D

from .params import RobotParams


class WheelOdometry:
    """Turns encoder counts into motion, with the wheels as the controller takes them to be.

    The two wheels are taken to turn evenly between two readings, so that the base moves on a circular arc.
    """

    def __init__(self, robot: RobotParams) -> None:
        odometry = robot.odometry
        self._metres_per_tick = 2.0 * math.pi * odometry.wheel_radius / odometry.ticks_per_rev
        self._track = odometry.track
        self._ticks = (0, 0)

    def reset(self, ticks: tuple[int, int]) -> None:
        """Start from these cumulative counts of the left and the right wheel."""
        self._ticks = ticks

    def update(self, ticks: tuple[int, int]) -> Pose2D:
        """Return the base's pose now, seen from the base at the last call, from cumulative counts (left, right)."""
        left = (ticks[0] - self._ticks[0]) * self._metres_per_tick
        right = (ticks[1] - self._ticks[1]) * self._metres_per_tick
        self._ticks = ticks
        half_turn = 0.5 * (right - left) / self._track
        distance = 0.5 * (left + right)
        chord = distance * math.sin(half_turn) / half_turn if half_turn != 0.0 else distance
        return Pose2D(chord * math.cos(half_turn), chord * math.sin(half_turn), 2.0 * half_turn)
