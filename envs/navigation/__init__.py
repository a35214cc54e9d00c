"""Costmaps, frontiers, path planning and driving on the estimated map."""

from lidarnaut.envs.geometry.occupancy_grid import crop_to_known

from .candidates import CANDIDATE, FEATURES, Candidates, GainOverCost, Markers, failed_last, robot_features
from .costmap import (
    COST_FREE,
    COST_INSCRIBED,
    COST_LETHAL,
    COST_MAX_FREE,
    COST_UNKNOWN,
    Costmap,
    CostmapParams,
    make_costmap,
)
from .docking import DockNavigator
from .dwb import DwbPlanner
from .frontier_navigator import FrontierNavigator
from .frontiers import frontier_mask
from .goal_navigator import GoalNavigator, GoalParams, HomeNavigator
from .mppi import MppiParams, MppiPlanner
from .navigator import Navigator
from .obstacles import NO_POINTS, free_distance
from .paths import TravelField, is_path_valid, plan_path, smooth_path, travel_field
from .planning_map import PlanningMap
from .planning_params import DwbParams, NavigatorParams, PlanningParams
from .regulated_pursuit import FollowerParams, PathFollower
from .views import NUM_SECTORS

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
    "frontier_mask",
    "is_path_valid",
    "make_costmap",
    "plan_path",
    "robot_features",
    "smooth_path",
    "travel_field",
]
