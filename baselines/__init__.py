"""Classic explorers."""

from collections.abc import Callable
from functools import partial

from envs.files import resolve

from .explorer import Explorer, Omniscient
from .frontier import explore_lite, next_best_view
from .frontier.explore_lite import ExploreLiteExplorer, ExploreLiteParams
from .frontier.gain_over_cost import GainOverCostExplorer, GainOverCostParams
from .frontier.greedy_gain import GreedyGainExplorer
from .frontier.nearest import NearestExplorer, NearestParams
from .frontier.next_best_view import NextBestViewExplorer, NextBestViewParams
from .frontier.pursuit import PursuitExplorer
from .frontier.tour import TourExplorer, TourParams
from .frontier.utility import FrontierExplorer, FrontierParams
from .oracle.explorer import OracleExplorer
from .random import RandomExplorer
from .rrt.explorer import RrtExplorer
from .rrt.params import RrtParams
from .wall_following import WallFollower

EXPLORERS: dict[str, Callable[[], Explorer]] = {
    "random": RandomExplorer,
    "nearest": NearestExplorer,
    "frontier": FrontierExplorer,
    "tour": TourExplorer,
    "explore_lite": ExploreLiteExplorer,
    "explore_lite:published": partial(ExploreLiteExplorer, explore_lite.PUBLISHED),
    "gain_over_cost": GainOverCostExplorer,
    "pursuit": PursuitExplorer,
    "greedy_gain": GreedyGainExplorer,
    "next_best_view": NextBestViewExplorer,
    "next_best_view:published": partial(NextBestViewExplorer, next_best_view.PUBLISHED),
    "wall_follower": WallFollower,
    "rrt": RrtExplorer,
    "oracle": OracleExplorer,
}
"""Explorers by name; `:published` have the parameters of their sources, the others tuned ones."""


def make_explorer(name: str) -> Explorer:
    """Return a new explorer with its default parameters, by name or as `module:attribute`.

    Raises:
        ValueError: the name is unknown.
    """
    explorer: Explorer = resolve(name, EXPLORERS, "explorer")()
    return explorer


__all__ = [
    "EXPLORERS",
    "ExploreLiteExplorer",
    "ExploreLiteParams",
    "Explorer",
    "FrontierExplorer",
    "FrontierParams",
    "GainOverCostExplorer",
    "GainOverCostParams",
    "GreedyGainExplorer",
    "NearestExplorer",
    "NearestParams",
    "NextBestViewExplorer",
    "NextBestViewParams",
    "Omniscient",
    "OracleExplorer",
    "PursuitExplorer",
    "RandomExplorer",
    "RrtExplorer",
    "RrtParams",
    "TourExplorer",
    "TourParams",
    "WallFollower",
    "make_explorer",
]
