"""Classic policies, by the tasks that they can do."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
from gymnasium import spaces

from lidarnaut.envs.files import resolve
from lidarnaut.envs.navigation import GoalNavigator, GoalParams

from .explorer import Explorer, Omniscient, OnePerRobot, Policy
from .frontier.explorer import RuleExplorer
from .frontier.pursuit import PursuitExplorer
from .frontier.rules import (
    PUBLISHED_LITE,
    PUBLISHED_VIEWS,
    ExploreLite,
    ExploreLiteExplorer,
    GainOverCostExplorer,
    GreedyGainExplorer,
    NearestExplorer,
    NextBestViewExplorer,
    NextBestViewParams,
)
from .frontier.tour import TourExplorer, TourParams
from .frontier.utility import FrontierExplorer, FrontierParams
from .oracle.explorer import OracleExplorer
from .reactive import RandomChooser, RandomExplorer, RouteFollower, WallFollower
from .rrt.detector import RrtParams
from .rrt.team import RrtExplorer, RrtTeam
from .teams.assignment import Auction, MinMaxTours
from .teams.team import TeamExplorer

EXPLORERS: dict[str, Callable[[], Explorer]] = {
    "random": RandomExplorer,
    "nearest": NearestExplorer,
    "frontier": FrontierExplorer,
    "tour": TourExplorer,
    "explore_lite": ExploreLiteExplorer,
    "explore_lite:published": partial(ExploreLiteExplorer, PUBLISHED_LITE),
    "gain_over_cost": GainOverCostExplorer,
    "pursuit": PursuitExplorer,
    "greedy_gain": GreedyGainExplorer,
    "next_best_view": NextBestViewExplorer,
    "next_best_view:published": partial(NextBestViewExplorer, PUBLISHED_VIEWS),
    "wall_follower": WallFollower,
    "rrt": RrtExplorer,
    "oracle": OracleExplorer,
}
"""Explorers by name; `:published` have the parameters of their sources, the others tuned ones.

:meta hide-value:
"""
Makers = Mapping[str, Callable[[], Any]]
"""What makes policies, by their names."""
ANY: Makers = {"random": RandomExplorer, "wall_follower": WallFollower}
"""Of robots that are driven by twists, whatever their task."""
_PATIENT = GoalParams(max_recoveries=50, max_searches=20, search_radius=1.0)
DRIVES = {
    "pursuit": _PATIENT,
    "pursuit:fast": replace(_PATIENT, local_planner="rpp:fast"),
    "dwb": replace(_PATIENT, local_planner="dwb", track_people=True),
    "mppi": replace(_PATIENT, local_planner="mppi", track_people=True),
}
"""Drives to goals by name. They do not give up soon: what blocks the path may be somebody who walks on.
Where the task goes on after they have arrived, the goal is somewhere near."""
OFFERED: Mapping[str, Makers] = {
    "coverage": EXPLORERS,
    "goal": {name: partial(GoalNavigator, params) for name, params in DRIVES.items()},
    "route": {"route_follower": RouteFollower},
}
"""Of tasks that offer something: attributes of the task; see `policies_for`."""
TEAMS: Mapping[str, Makers] = {
    "coverage": {
        "rrt_team": RrtTeam,
        "auction": partial(TeamExplorer, Auction()),
        "mtsp": partial(TeamExplorer, MinMaxTours()),
    }
}
"""The same of tasks of teams, where actions have an axis for the robots."""
CLASSIC = frozenset(name for makers in (ANY, *OFFERED.values(), *TEAMS.values()) for name in makers)
"""Names of all classic policies."""


def policies_for(env: gymnasium.Env[Any, Any]) -> Makers:
    """Return the classic policies that can do the task of an environment, by name; it must have been reset.

    What the task offers decides, and how the environment is driven: a task of your own with a `goal` is driven by
    `pursuit`, too. The same name may mean another policy where the task is another.
    """
    inner: Any = getattr(env.unwrapped, "explore", env.unwrapped)
    if isinstance(env.action_space, spaces.Discrete):
        rules = {name: make for name, make in EXPLORERS.items() if isinstance(make(), RuleExplorer)}
        return {"random": RandomChooser, **rules}
    is_team = len(inner.action_space.shape or ()) > 1
    offered = [makers for name, makers in (TEAMS if is_team else OFFERED).items() if hasattr(inner.task, name)]
    alone = {name: partial(_one_per_robot, make) for name, make in ANY.items()} if is_team else ANY
    return {name: make for makers in (*offered, alone) for name, make in makers.items()}


def _one_per_robot(make: Callable[[], Explorer]) -> OnePerRobot:
    return OnePerRobot(make())


def make_explorer(name: str) -> Explorer:
    """Return a new explorer with its default parameters, by name or as `module:attribute`.

    Raises:
        ValueError: the name is unknown.
    """
    explorer: Explorer = resolve(name, EXPLORERS, "explorer")()
    return explorer


__all__ = [
    "CLASSIC",
    "EXPLORERS",
    "Auction",
    "ExploreLite",
    "ExploreLiteExplorer",
    "Explorer",
    "FrontierExplorer",
    "FrontierParams",
    "GainOverCostExplorer",
    "GreedyGainExplorer",
    "MinMaxTours",
    "NearestExplorer",
    "NextBestViewExplorer",
    "NextBestViewParams",
    "Omniscient",
    "OnePerRobot",
    "OracleExplorer",
    "Policy",
    "PursuitExplorer",
    "RandomExplorer",
    "RouteFollower",
    "RrtExplorer",
    "RrtParams",
    "RrtTeam",
    "TeamExplorer",
    "TourExplorer",
    "TourParams",
    "WallFollower",
    "make_explorer",
    "policies_for",
]
