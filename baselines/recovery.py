"""Noticing that the robot gets nowhere, and getting it free."""

import math
from collections import deque

import numpy as np

from envs.geometry import Pose2D
from envs.navigation import free_distance
from envs.robots import RobotParams
from envs.simulation import Twist

SPIN_RATE = 1.0
"""Yaw rate of turns that are made to look around or to get free, where the robot can turn that fast [rad/s]."""


class Dwell:
    """Counts for how long a pose stays about the same."""

    def __init__(self, distance: float, angle: float = math.inf) -> None:
        """Start anew.

        Args:
            distance: a pose this far from the first one is another [m].
            angle: a heading that differs by this much as well [rad].
        """
        self._distance = distance
        self._angle = angle
        self._anchor: Pose2D | None = None
        self._steps = 0

    def restart(self) -> None:
        """Forget what was counted."""
        self._anchor = None

    def update(self, pose: Pose2D) -> int:
        """Take in the next pose and return how many have been about the same before it."""
        if self._anchor is not None:
            away = self._anchor.between(pose)
            if math.hypot(away.x, away.y) < self._distance and abs(away.theta) < self._angle:
                self._steps += 1
                return self._steps
        self._anchor, self._steps = pose, 0
        return 0


class Maneuvers:
    """Short drives that are carried out one after the other, whatever the plan is."""

    def __init__(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Start with none.

        Args:
            robot: limits and footprint.
            control_period: duration of a twist [s].
            rng: decides which way to turn, and how far.
        """
        self._robot = robot
        self._period = control_period
        self._rng = rng
        self._queue: deque[tuple[Twist, int]] = deque()

    def __bool__(self) -> bool:
        """Tell whether any is left."""
        return bool(self._queue)

    def clear(self) -> None:
        """Leave out what is left."""
        self._queue.clear()

    def spin(self, angle: float) -> None:
        """Turn on the spot by `angle` [rad]."""
        rate = min(self._robot.max_w, SPIN_RATE)
        steps = max(1, round(abs(angle) / rate / self._period))
        self._queue.append((Twist(0.0, math.copysign(rate, angle)), steps))

    def back_off(self, obstacles: np.ndarray, *, backwards: bool) -> None:
        """Leave the place straight on, and turn a little.

        Args:
            obstacles: shape (n, 2), float64, base frame [m].
            backwards: which way, unless it is blocked and there is more room on the other.
        """
        robot = self._robot
        reach = 0.5 * robot.radius + 0.1
        room = {sign: free_distance(obstacles, 0.0, robot.radius, sign * reach) for sign in (-1.0, 1.0)}
        sign = -1.0 if backwards else 1.0
        if room[sign] < 0.5 * reach and room[-sign] > room[sign]:
            sign = -sign
        speed = 0.4 * robot.max_v
        self._queue.append((Twist(sign * speed, 0.0), max(1, round(reach / speed / self._period))))
        self.spin(self._rng.uniform(0.5, 1.2) * (1.0 if self._rng.random() < 0.5 else -1.0))

    def next(self, obstacles: np.ndarray) -> Twist:
        """Return the next twist; a straight drive that has become blocked ends.

        Args:
            obstacles: shape (n, 2), float64, base frame [m].
        """
        twist, steps = self._queue.popleft()
        look = twist.v * self._period * 2.0
        if twist.v != 0.0 and free_distance(obstacles, 0.0, self._robot.radius, look) < 0.5 * abs(look):
            return Twist(0.0, 0.0)
        if steps > 1:
            self._queue.appendleft((twist, steps - 1))
        return twist
