"""Random arcs and random frontiers: the lowest reference of all comparisons."""

import numpy as np

from baselines.frontier.explorer import RuleExplorer
from envs.estimation import Belief
from envs.navigation import Candidates
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


class RandomExplorer:
    """Draws forward speed and yaw rate uniformly within the robot's limits."""

    end_reason = plan = None
    """Never stops, never plans."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot = robot
        self._rng = rng

    def act(self, reading: Reading, belief: Belief) -> Twist:
        v, w = self._rng.uniform(-1.0, 1.0, 2).tolist()
        return Twist(v * self._robot.max_v, w * self._robot.max_w)


class RandomChooser(RuleExplorer):
    """Draws any candidate."""

    def __init__(self) -> None:
        super().__init__(self._draw)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._rng = rng

    def _draw(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        return np.arange(len(candidates)) == self._rng.integers(len(candidates))
