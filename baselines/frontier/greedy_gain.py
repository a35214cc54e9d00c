"""Greedy information gain: to wherever the most unknown area would be observed, however far it is."""

from baselines.frontier.explorer import COMMITTED, RuleExplorer, least
from envs.estimation import Belief
from envs.navigation import Candidates


def greedy_gain(candidates: Candidates, belief: Belief) -> int:
    """Take the frontier with the most unknown area in view; of equal ones the cheaper."""
    return least(-candidates.visible, candidates)


class GreedyGainExplorer(RuleExplorer):
    """Goes where `greedy_gain` says."""

    def __init__(self) -> None:
        super().__init__(greedy_gain, max_time=COMMITTED)
