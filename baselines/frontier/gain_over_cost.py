"""The ratio of gain and cost: unknown area in view over the length of the path; see `envs.navigation.rating`."""

import numpy as np

from baselines.frontier.explorer import RuleExplorer, least
from envs.estimation import Belief
from envs.navigation import Candidates, GainOverCostParams, gain_over_cost


class GainOverCost:
    """Takes the frontier with the greatest `(gain + least_gain) / (cost + least_cost)`."""

    def __init__(self, params: GainOverCostParams = GainOverCostParams()) -> None:
        self._params = params

    def __call__(self, candidates: Candidates, belief: Belief) -> int:
        return least(-self.rate(candidates), candidates)

    def rate(self, candidates: Candidates) -> np.ndarray:
        """Return the logarithms of the ratios, shape (k,), float64."""
        return gain_over_cost(candidates, self._params)


class GainOverCostExplorer(RuleExplorer):
    """Goes where `GainOverCost` says, and asks it anew every four seconds."""

    def __init__(self, params: GainOverCostParams = GainOverCostParams()) -> None:
        super().__init__(GainOverCost(params))
