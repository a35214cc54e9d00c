"""Frontier exploration that follows paths without slowing down in bends."""

import math

import numpy as np

from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import FrontierNavigator, GainOverCost, free_distance
from lidarnaut.envs.observations.plan import LOOKAHEADS, look_ahead
from lidarnaut.envs.simulation import Reading, Twist

PERIOD = 1.0
"""Time between choices of a frontier [s]."""
TURN = 1.2
"""Proportional gain of the heading controller: yaw rate / maximum yaw rate, per heading error [1/rad]."""


class PursuitDriving(RuleExplorer):
    """Frontier explorer that steers to a near point on the path and does not slow down in bends.

    Near obstacles and in recoveries, the standard navigator drives.
    """

    def act(self, reading: Reading, belief: Belief) -> Twist:
        twist, frontiers = super().act(reading, belief), self.navigator
        if frontiers is None or self.end_reason is not None:
            return twist
        return pursue(frontiers, belief.pose, twist, frontiers.navigator.obstacles)


class PursuitExplorer(PursuitDriving):
    """Chooses frontiers by unknown area divided by path cost, and does not slow down in bends."""

    def __init__(self) -> None:
        super().__init__(GainOverCost(), max_time=PERIOD)


def pursue(frontiers: FrontierNavigator, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
    """Return the velocity command towards a point ahead on the planned path.

    In recoveries, or with an obstacle in the way, returns `twist`, the command of the standard navigator. `frontiers`:
    navigator that drives to the frontier. `obstacles`: points, shape (n, 2), float64, base frame [m].
    """
    navigator, robot = frontiers.navigator, frontiers.robot
    if navigator.is_recovering or navigator.plan is None:
        return twist
    path = np.vstack([navigator.plan, np.array(frontiers.target)])  # frontier
    direction = np.empty(2, dtype=np.float32)
    look_ahead(path, 0, tuple(pose), LOOKAHEADS[:1], direction)
    cosine, sine = direction.tolist()
    turn = min(max(TURN * math.atan2(sine, cosine), -1.0), 1.0)
    pursuit = Twist(max(cosine, 0.0) * robot.max_v, turn * robot.max_w)
    curvature, numbers = pursuit.w / max(pursuit.v, 1e-6), navigator.numbers
    if free_distance(obstacles, curvature, numbers["reach"], numbers["look"]) < numbers["look"]:
        return twist
    navigator.note_command(pursuit)
    return pursuit
