"""Greedy information gain: to wherever the most unknown area would be observed, however far it is."""

import numpy as np

from baselines.frontier.explorer import COMMITTED, RuleExplorer, least
from baselines.frontier.visible_gain import visible_gains
from envs.estimation import Belief
from envs.navigation import Candidates
from envs.robots import RobotParams


class GreedyGain:
    """Takes the frontier with the most unknown area in the lidar's range; of equal ones the cheaper."""

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._range = robot.lidar.range_max

    def __call__(self, candidates: Candidates, belief: Belief) -> int:
        return least(-visible_gains(candidates.costmap.grid, candidates.viewpoints, self._range), candidates)


class GreedyGainExplorer(RuleExplorer):
    """Goes where `GreedyGain` says."""

    def __init__(self) -> None:
        super().__init__(GreedyGain(), max_time=COMMITTED)
