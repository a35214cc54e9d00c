"""Costmaps, frontiers, path planning and driving on the estimated map."""

from lidarnaut.envs.geometry.occupancy_grid import crop_to_known

from .controllers.dwb import DwbPlanner
from .controllers.local_planner import LocalPlanner
from .controllers.mppi import MppiParams, MppiPlanner
from .controllers.navigator import Navigator
from .controllers.regulated_pursuit import FollowerParams, PathFollower
from .frontiers.candidates import CANDIDATE, FEATURES, Candidates, GainOverCost, Markers, failed_last, robot_features
from .frontiers.frontier_navigator import FrontierNavigator
from .frontiers.views import NUM_SECTORS
from .goals.docking import DockNavigator
from .goals.goal_navigator import GoalNavigator, GoalParams, HomeNavigator
from .maps.costmap import (
    COST_FREE,
    COST_INSCRIBED,
    COST_LETHAL,
    COST_MAX_FREE,
    COST_UNKNOWN,
    Costmap,
    CostmapParams,
    make_costmap,
)
from .maps.obstacles import NO_POINTS, free_distance
from .maps.planning_map import PlanningMap
from .maps.planning_params import DwbParams, NavigatorParams, PlanningParams
from .search.paths import TravelField, is_path_valid, plan_path, travel_field

__all__ = [
    "CANDIDATE",
    "COST_FREE",
    "COST_INSCRIBED",
    "COST_LETHAL",
    "COST_MAX_FREE",
    "COST_UNKNOWN",
    "FEATURES",
    "NO_POINTS",
    "NUM_SECTORS",
    "Candidates",
    "Costmap",
    "CostmapParams",
    "DockNavigator",
    "DwbParams",
    "DwbPlanner",
    "FollowerParams",
    "FrontierNavigator",
    "GainOverCost",
    "GoalNavigator",
    "GoalParams",
    "HomeNavigator",
    "LocalPlanner",
    "Markers",
    "MppiParams",
    "MppiPlanner",
    "Navigator",
    "NavigatorParams",
    "PathFollower",
    "PlanningMap",
    "PlanningParams",
    "TravelField",
    "crop_to_known",
    "failed_last",
    "free_distance",
    "is_path_valid",
    "make_costmap",
    "plan_path",
    "robot_features",
    "travel_field",
]
