"""Nearest frontier first: the planner that tuned ones beat by a few percent (Yamauchi, 1997)."""

from dataclasses import dataclass

from baselines.frontier.explorer import RuleExplorer, least
from envs.estimation import Belief
from envs.navigation import Candidates, PlanningParams

CELL = 0.05
"""Side of the cells that sizes count [m]."""


def nearest(candidates: Candidates, belief: Belief) -> int:
    """Take the candidate that is cheapest to get to: the length of the path, weighted by nearness to obstacles."""
    return least(candidates.costs, candidates)


@dataclass(frozen=True, slots=True)
class NearestParams:
    """What counts as a frontier worth going to."""

    sizes: tuple[int, ...] = (8, 3)
    """Least number of touching frontier cells of 5 cm; the next one is taken when nothing of the size before can be
    reached."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """Distances of viewpoints from a frontier; the first one from which it can be seen is taken [m]."""


class NearestExplorer(RuleExplorer):
    """Goes to the frontier that is cheapest to get to."""

    def __init__(self, params: NearestParams = NearestParams()) -> None:
        lengths = tuple(CELL * size for size in params.sizes)
        planning = PlanningParams(min_lengths=lengths, view_distances=params.view_distances)
        super().__init__(nearest, max_candidates=4, planning=planning)
