"""Reactive driving: obstacle avoidance by scan alone, without map or goal."""

import math

import numpy as np

from lidarnaut.envs.navigation.maps.obstacles import free_distance
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist

CURVATURES = (0.0, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0)
ARC_LENGTH = 1.2
"""Length of the arcs tested for collisions [m]; the robot's radius is added."""
CLEARANCE_MARGIN = 0.04
"""Distance kept from obstacles [m]."""
SPEED = 0.7
"""Forward speed as a fraction of the maximum speed."""
TURN_RATE = 0.8
"""Maximum yaw rate [rad/s], limited by the robot."""
BIAS_TIME = (6.0, 15.0)
"""Minimum and maximum time between changes of the random curvature bias [s]."""
MAX_BIAS = 0.3


class ReactiveDriver:
    """Drives along the arc with most clearance. A random curvature bias prevents circling."""

    def __init__(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._period, self._rng = robot, control_period, rng
        self._bias = self._turning = 0.0
        self._bias_steps = 0

    def command(self, obstacles: np.ndarray) -> Twist:
        """Return the next velocity command; `obstacles`: points, shape (n, 2), base frame [m]."""
        robot = self._robot
        self._bias_steps -= 1
        if self._bias_steps <= 0:
            self._bias = self._rng.uniform(-MAX_BIAS, MAX_BIAS)
            self._bias_steps = round(self._rng.uniform(*BIAS_TIME) / self._period)
        radius, reach = robot.radius + CLEARANCE_MARGIN, robot.radius + ARC_LENGTH
        clearance = np.array([free_distance(obstacles, curvature, radius, reach) for curvature in CURVATURES])
        if self._turning != 0.0 and clearance[0] < 0.5 * reach:
            return self._turn()
        self._turning = 0.0
        best = int(np.argmax(clearance - 0.1 * reach * np.abs(np.array(CURVATURES) - self._bias)))
        v = min(SPEED * robot.max_v, math.sqrt(robot.max_acc_v * max(clearance[best] - 0.05, 0.0)))
        if v < 0.1 * robot.max_v:
            left, right = (self._clearance_beside(obstacles, side) for side in (1.0, -1.0))
            self._turning = 1.0 if left + self._bias >= right else -1.0
            return self._turn()
        w = v * CURVATURES[best]
        limit = min(robot.max_w, TURN_RATE)
        return Twist(v, w) if abs(w) <= limit else Twist(v * limit / abs(w), math.copysign(limit, w))

    def _turn(self) -> Twist:
        return Twist(0.0, math.copysign(min(TURN_RATE, self._robot.max_w), self._turning))

    def _clearance_beside(self, obstacles: np.ndarray, side: float) -> float:
        beside = obstacles[side * obstacles[:, 1] > 0.0]
        return min(ARC_LENGTH, float(np.hypot(*beside.T).min())) if len(beside) else ARC_LENGTH
