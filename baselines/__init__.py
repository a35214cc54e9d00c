"""Classical (not learned) policies for exploration and navigation."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
from gymnasium import spaces

from lidarnaut.envs.navigation import DockNavigator, GoalNavigator, GoalParams

from .frontier.pursuit_explorer import PursuitExplorer
from .frontier.rule_explorer import RuleExplorer
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
from .frontier.utility import AGV_DWB, FrontierExplorer, FrontierParams
from .oracle.oracle_explorer import OracleExplorer
from .policy import Explorer, OnePerRobot, Policy, PrivilegedPolicy
from .reactive import RandomChooser, RandomExplorer, RouteFollower, WallFollower
from .rrt.detector import RrtParams
from .rrt.team import RrtExplorer, RrtTeam
from .sweeping import Bouncer, SweepNavigator, boustrophedon, spiral
from .teams.assignment import Auction, MinMaxTours
from .teams.team import TeamExplorer

EXPLORERS: dict[str, Callable[[], Explorer]] = {
    "random": RandomExplorer,
    "nearest": NearestExplorer,
    "frontier": FrontierExplorer,
    "frontier:published": partial(FrontierExplorer, dwb=AGV_DWB),
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
"""Explorer classes by name. Parameters are tuned, or as in the cited publication (`:published`).

:meta hide-value:"""
Makers = Mapping[str, Callable[[], Any]]
ANY: Makers = {"random": RandomExplorer, "wall_follower": WallFollower}
_PATIENT = GoalParams(max_recoveries=50, max_searches=20, search_radius=1.0)
_DWB = replace(_PATIENT, local_planner="dwb", track_people=True)
DRIVES = {
    "pursuit": partial(GoalNavigator, _PATIENT),
    "pursuit:fast": partial(GoalNavigator, replace(_PATIENT, local_planner="rpp:fast")),
    "dwb": partial(GoalNavigator, _DWB),
    "dwb:agv": partial(GoalNavigator, _DWB, dwb=AGV_DWB),
    "mppi": partial(GoalNavigator, replace(_PATIENT, local_planner="mppi", track_people=True)),
}
"""Goal navigators by policy name, with many recovery behaviors because people may block paths."""
OFFERED: Mapping[str, Makers] = {
    "coverage": EXPLORERS,
    "goal": DRIVES,
    "charge": {"dock": partial(DockNavigator, replace(_PATIENT, search_radius=0.0))},
    "swept_fraction": {
        "boustrophedon": partial(SweepNavigator, boustrophedon),
        "spiral": partial(SweepNavigator, spiral),
        "bounce": Bouncer,
    },
    "route": {"route_follower": RouteFollower},
}
"""Constructors of single-robot policies by name, grouped by the attribute that a task must have: `coverage`, `goal`,
`charge`, `swept_fraction` or `route`."""
TEAMS: Mapping[str, Makers] = {
    "coverage": {
        "rrt_team": RrtTeam,
        "auction": partial(TeamExplorer, Auction()),
        "mtsp": partial(TeamExplorer, MinMaxTours()),
    }
}
"""Constructors of team policies by name, grouped by the attribute that a task must have."""
ALL: Makers = {name: make for some in (*OFFERED.values(), *TEAMS.values(), EXPLORERS) for name, make in some.items()}
"""Constructors of all policies by name; an explorer, if policies of several tasks have the same name."""


def policies_for(env: gymnasium.Env[Any, Any]) -> Makers:
    """Return constructors of the classical policies that suit an environment's task, by name.

    The environment must be reset. For example, `pursuit` requires a task with a `goal`.
    """
    inner: Any = getattr(env.unwrapped, "explore", env.unwrapped)
    if isinstance(env.action_space, spaces.Discrete):
        rules = {name: make for name, make in EXPLORERS.items() if isinstance(make(), RuleExplorer)}
        return {"random": RandomChooser, **rules}
    is_team = len(inner.action_space.shape or ()) > 1
    found = (TEAMS if is_team else OFFERED).items()
    offered = [makers for name, makers in found if getattr(inner.task, name, None) is not None]
    alone = {name: partial(OnePerRobot, make()) for name, make in ANY.items()} if is_team else ANY
    return {name: make for makers in (*offered, alone) for name, make in makers.items()}


__all__ = [
    "ALL",
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
    "OnePerRobot",
    "OracleExplorer",
    "Policy",
    "PrivilegedPolicy",
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
    "policies_for",
]
