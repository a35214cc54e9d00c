"""Costmaps, frontiers and path planning on the estimated map."""

from .candidate_features import FEATURES, Candidates, robot_features
from .candidate_views import NUM_SECTORS
from .checks import check_goal, is_path_valid
from .costmap import (
    COST_FREE,
    COST_INSCRIBED,
    COST_LETHAL,
    COST_MAX_FREE,
    COST_UNKNOWN,
    Costmap,
    CostmapParams,
    crop_to_known,
    make_costmap,
)
from .dwb import DwbParams, DwbPlanner
from .frontier_navigator import FrontierNavigator
from .frontiers import count_unknown, frontier_mask
from .layers import LayeredCostmap, ObstacleParams
from .local_planner import LocalPlanner
from .navigator import Navigator
from .obstacles import NO_POINTS, free_distance, mark_missing
from .params import NavigatorParams, PlanningParams
from .paths import TravelField, plan_path, travel_field
from .planning_map import PlanningMap
from .pursuit import FollowerParams
from .rating import GainOverCostParams, gain_over_cost
from .smoothing import smooth_path

__all__ = [
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
    "DwbParams",
    "DwbPlanner",
    "FollowerParams",
    "FrontierNavigator",
    "GainOverCostParams",
    "LayeredCostmap",
    "LocalPlanner",
    "Navigator",
    "NavigatorParams",
    "ObstacleParams",
    "PlanningMap",
    "PlanningParams",
    "TravelField",
    "check_goal",
    "count_unknown",
    "crop_to_known",
    "free_distance",
    "frontier_mask",
    "gain_over_cost",
    "is_path_valid",
    "make_costmap",
    "mark_missing",
    "plan_path",
    "robot_features",
    "smooth_path",
    "travel_field",
]
