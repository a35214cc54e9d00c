"""Driving about by the scan alone: safe wherever the robot is, whatever it believes."""

import math

import numpy as np

from envs.navigation import free_distance
from envs.robots import RobotParams
from envs.simulation import Twist

BENDS = (0.0, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0)
"""Curvatures that are tried [1/m]."""
LOOK = 1.2
"""How far along each [m], beyond the robot's radius."""
MARGIN = 0.04
"""Distance that is kept between footprint and obstacles [m]."""
SPEED = 0.7
"""Share of the greatest speed."""
TURN_RATE = 0.8
"""Yaw rate of turns on the spot, where the robot can turn that fast [rad/s]."""
WHIM_TIME = (6.0, 15.0)
"""How long the robot favours a side, at least and at most [s]."""


class ReactiveDriver:
    """Drives where there is room, and favours a side for a while so that it does not go in circles."""

    def __init__(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a robot.

        Args:
            robot: limits and footprint.
            control_period: time between two calls of `command` [s].
            rng: decides which side to favour, and for how long.
        """
        self._robot = robot
        self._period = control_period
        self._rng = rng
        self._whim = 0.0
        self._whim_steps = 0
        self._turning = 0.0

    def command(self, obstacles: np.ndarray) -> Twist:
        """Return the twist for the next period; `obstacles` has the shape (n, 2), base frame [m]."""
        robot = self._robot
        self._whim_steps -= 1
        if self._whim_steps <= 0:
            self._whim = self._rng.uniform(-0.3, 0.3)
            self._whim_steps = round(self._rng.uniform(*WHIM_TIME) / self._period)
        radius, look = robot.radius + MARGIN, robot.radius + LOOK
        room = np.array([free_distance(obstacles, bend, radius, look) for bend in BENDS])
        if self._turning != 0.0 and room[0] < 0.5 * look:
            return self._turn()
        self._turning = 0.0
        best = int(np.argmax(room - 0.1 * look * np.abs(np.array(BENDS) - self._whim)))
        brake = robot.max_acc_v
        v = min(SPEED * robot.max_v, math.sqrt(brake * max(room[best] - 0.05, 0.0)))
        if v < 0.1 * robot.max_v:
            left, right = (self._room_beside(obstacles, side) for side in (1.0, -1.0))
            self._turning = 1.0 if left + self._whim >= right else -1.0
            return self._turn()
        w = v * BENDS[best]
        limit = min(robot.max_w, TURN_RATE)
        return Twist(v, w) if abs(w) <= limit else Twist(v * limit / abs(w), math.copysign(limit, w))

    def _turn(self) -> Twist:
        return Twist(0.0, math.copysign(min(TURN_RATE, self._robot.max_w), self._turning))

    def _room_beside(self, obstacles: np.ndarray, side: float) -> float:
        """Return the distance to the nearest obstacle on a side (1 left, -1 right), at most `LOOK` [m]."""
        beside = obstacles[side * obstacles[:, 1] > 0.0]
        return min(LOOK, float(np.hypot(*beside.T).min())) if len(beside) else LOOK
