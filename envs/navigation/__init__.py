"""Costmaps, frontiers, path planning and driving on the estimated map."""

from lidarnaut.envs.geometry.occupancy_grid import crop_to_known
from lidarnaut.envs.navigation.controllers.dwb import DwbPlanner
from lidarnaut.envs.navigation.controllers.local_planner import LocalPlanner
from lidarnaut.envs.navigation.controllers.mppi import MppiParams, MppiPlanner
from lidarnaut.envs.navigation.controllers.navigator import Navigator
from lidarnaut.envs.navigation.controllers.regulated_pursuit import FollowerParams, PathFollower
from lidarnaut.envs.navigation.frontiers.candidates import (
    CANDIDATE,
    FEATURES,
    Candidates,
    GainOverCost,
    Markers,
    failed_last,
    robot_features,
)
from lidarnaut.envs.navigation.frontiers.frontier_navigator import FrontierNavigator
from lidarnaut.envs.navigation.frontiers.frontiers import frontier_mask
from lidarnaut.envs.navigation.frontiers.views import NUM_SECTORS
from lidarnaut.envs.navigation.goals.docking import DockNavigator
from lidarnaut.envs.navigation.goals.goal_navigator import GoalNavigator, GoalParams, HomeNavigator
from lidarnaut.envs.navigation.maps.costmap import (
    COST_FREE,
    COST_INSCRIBED,
    COST_LETHAL,
    COST_MAX_FREE,
    COST_UNKNOWN,
    Costmap,
    CostmapParams,
    make_costmap,
)
from lidarnaut.envs.navigation.maps.obstacles import NO_POINTS, free_distance
from lidarnaut.envs.navigation.maps.planning_map import PlanningMap
from lidarnaut.envs.navigation.maps.planning_params import DwbParams, NavigatorParams, PlanningParams
from lidarnaut.envs.navigation.search.paths import TravelField, is_path_valid, plan_path, smooth_path, travel_field

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
    "frontier_mask",
    "is_path_valid",
    "make_costmap",
    "plan_path",
    "robot_features",
    "smooth_path",
    "travel_field",
]
