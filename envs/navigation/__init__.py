"""Costmaps, frontiers and path planning on what the robot believes."""

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
from .frontiers import clear_around, count_unknown, dbscan, frontier_clusters, frontier_mask
from .paths import TravelField, plan_path, travel_field

__all__ = [
    "COST_FREE",
    "COST_INSCRIBED",
    "COST_LETHAL",
    "COST_MAX_FREE",
    "COST_UNKNOWN",
    "Costmap",
    "CostmapParams",
    "TravelField",
    "clear_around",
    "count_unknown",
    "crop_to_known",
    "dbscan",
    "frontier_clusters",
    "frontier_mask",
    "make_costmap",
    "plan_path",
    "travel_field",
]
