"""Keeps a wall to its right, by the scan alone: no map, no goals.

Of all arcs it drives the one that bends most to the right and still has room, which hugs walls, rounds corners and
turns out of dead ends alike. A robot that only did that would go round one pillar, or one room, for ever. Once it has
turned by a whole turn on balance, it has been round: it leaves the wall and drives straight on until it meets another.
"""

import math

import numpy as np

from baselines.explorer import to_action
from baselines.obstacles import ObstacleMemory
from baselines.recovery import Maneuvers
from baselines.senses import Senses
from envs.navigation import free_distance
from envs.robots import RobotParams
from envs.simulation import Reading, Twist
from envs.slam import Belief

BENDS = (-4.0, -2.0, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Curvatures that are tried, from right to left, for a robot of a tenth of a metre; larger ones bend less [1/m]."""
REFERENCE_RADIUS = 0.1
"""That robot's radius [m]."""
MARGIN = 0.12
"""Room that is kept between footprint and wall, where there is so much [m]."""
TIGHT_MARGIN = 0.02
"""Room that is kept otherwise [m]."""
LOOK = 0.8
"""How far along an arc there must be room [m], beyond the robot's radius."""
SPEED = 0.8
"""Share of the greatest speed."""
TURN_RATE = 1.0
"""Yaw rate of turns, where the robot can turn that fast [rad/s]."""
ROUND = 2.0 * math.pi
"""Turn on balance after which the robot has been round [rad]."""


class WallFollower:
    """Follows walls to its right, and leaves each for another one when it has been round."""

    plan: np.ndarray | None = None
    """Never plans."""
    end_reason: str | None = None
    """Never stops: without a map it cannot know when."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        self._robot = robot
        self._period = control_period
        self._rng = rng
        self._bends = np.array(BENDS) * REFERENCE_RADIUS / max(robot.radius, REFERENCE_RADIUS)
        self._senses = Senses(robot, control_period)
        self._memory = ObstacleMemory(robot, control_period)
        self._maneuvers = Maneuvers(robot, control_period, rng)
        self._is_following = False
        self._turned = 0.0

    def act(self, reading: Reading, belief: Belief | None) -> Twist:
        """Return the twist from `reading` alone; see `Explorer`."""
        robot, observation = self._robot, self._senses.observe(reading)
        motion = observation["motion"]
        obstacles = self._memory.update(observation["scan"], motion)
        if motion[4] > 0.5 and not self._maneuvers:
            self._maneuvers.back_off(obstacles, backwards=motion[2] >= 0.0)
        self._turned += float(motion[1]) * robot.max_w * self._period
        twist = self._maneuvers.next(obstacles) if self._maneuvers else self._command(obstacles)
        return self._senses.twist(to_action(twist, robot))

    def _command(self, obstacles: np.ndarray) -> Twist:
        """Return the twist along the wall, or straight on while there is none."""
        look = self._robot.radius + LOOK
        if self._is_following and abs(self._turned) > ROUND:
            # To which side the wall is left, chance decides: the same one would lead round the same way again.
            self._is_following = False
            self._maneuvers.spin(self._rng.uniform(0.4, 1.8))
            return self._maneuvers.next(obstacles)
        if not self._is_following:
            room = free_distance(obstacles, 0.0, self._robot.radius + MARGIN, look)
            if room >= look:
                return self._drive(0.0, room)
            self._is_following, self._turned = True, 0.0
        for margin in (MARGIN, TIGHT_MARGIN):
            for bend in self._bends:
                room = free_distance(obstacles, bend, self._robot.radius + margin, look)
                if room >= look:
                    return self._drive(float(bend), room)
        return Twist(0.0, min(TURN_RATE, self._robot.max_w))

    def _drive(self, bend: float, room: float) -> Twist:
        """Return the twist along an arc [1/m] with some room ahead [m]."""
        robot = self._robot
        v = min(SPEED * robot.max_v, math.sqrt(robot.max_acc_v * room))
        limit = min(TURN_RATE, robot.max_w)
        if abs(bend) * v > limit:
            v = limit / abs(bend)
        return Twist(v, bend * v)
