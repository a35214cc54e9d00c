"""The explorer that drives where a score says."""

import numpy as np

from baselines.frontier.explorer import RuleExplorer
from baselines.frontier.nearest import nearest
from baselines.frontier.pursuit import PursuitDriving
from envs.estimation import Belief
from envs.navigation import FEATURES, NUM_SECTORS, FrontierNavigator, robot_features
from envs.robots import RobotParams

from .score import FrontierScore

MAX_CANDIDATES = 48
"""Candidates that are scored at most, as in training."""


class ScoreExplorer(RuleExplorer):
    """Goes to the candidate of the greatest score, and scores anew every four seconds.

    At decision level the score chooses by itself; as an explorer it is not turned back, during a drive, to a goal that
    it has turned away from.
    """

    def __init__(self, score: FrontierScore) -> None:
        """Take a score."""
        super().__init__(nearest, max_candidates=MAX_CANDIDATES)  # the rule is not asked
        self.score = score
        size = MAX_CANDIDATES
        self._observation: dict[str, np.ndarray] = {
            "candidates": np.zeros((size, len(FEATURES)), dtype=np.float32),
            "sectors": np.zeros((size, 2 * NUM_SECTORS), dtype=np.float32),
            "gaps": np.zeros((size, size), dtype=np.float32),
            "action_mask": np.zeros(size, dtype=np.int8),
        }

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._observation["robot"] = robot_features(robot)

    @property
    def scores(self) -> np.ndarray | None:
        """Scores of the candidates at the last choice, shape (k,), float64."""
        return self.score.rate(self._observation)[1]

    def choose(self, navigator: FrontierNavigator, belief: Belief) -> int:
        seen = self._observation
        navigator.write_features(belief.pose, seen["candidates"], seen["sectors"], seen["gaps"])
        seen["action_mask"][:] = np.arange(MAX_CANDIDATES) < len(navigator.candidates)
        return int(self.score(seen))


class PursuitScoreExplorer(PursuitDriving, ScoreExplorer):
    """Goes to the same candidates by pursuit driving."""
