"""The numbers of planning in units of planning cells, for Numba."""

import math
from typing import NamedTuple

import numpy as np

from envs.navigation.astar import COST_WEIGHT, SCALE, STRAIGHT, step_weights
from envs.navigation.costmap import CostmapParams, Inflation
from envs.navigation.frontiers import OCCUPIED_FROM
from envs.navigation.params import PlanningParams
from envs.robots import RobotParams

FIRST_LIMIT = 16.0
"""Travel cost up to which the search for candidates expands at first [m]."""


class PlanningTables(NamedTuple):
    """Robot and `PlanningParams` in planning cells, for one footprint padding level."""

    block: int
    """Side of a planning cell [map cells]."""
    costs: np.ndarray
    """Shape (n,), uint8: cost by the squared distance to the nearest obstacle [cells2]."""
    weights: np.ndarray
    """Shape (256,), uint8, see `step_weights`."""
    inflation: int
    """Distance up to which nearness to an obstacle costs [cells]."""
    radius: int
    """How far from the robot's cell a search may start [cells]."""
    same_obstacle: int
    """[cells]"""
    marking_range: float
    """[m]"""
    max_extent: int
    """[cells]"""
    views: tuple[int, ...]
    """View distances [cells]."""
    detour: int
    """[travel cost]"""
    first_limit: int
    """Travel cost up to which the search for candidates expands at first; doubled until enough are known."""
    view_reach: int
    """How far rays look for unknown area [cells]."""
    heading_steps: int
    """[cells]"""
    robot_radius: float
    """Radius of the footprint that is planned for [m]."""


def costmap_params(params: PlanningParams, robot_radius: float) -> CostmapParams:
    """Return how obstacles spread for a footprint of a radius [m]."""
    return CostmapParams(robot_radius, robot_radius + params.inflation, params.cost_scaling_factor, OCCUPIED_FROM)


def tables_of(params: PlanningParams, robot: RobotParams, resolution: float) -> tuple[PlanningTables, ...]:
    """Return the tables of all footprint padding levels: the padded robot first, then smaller ones."""
    block = max(1, min(round(params.cell / resolution), int(robot.radius / resolution)))
    side = block * resolution

    def tables(radius: float) -> PlanningTables:
        inflation = Inflation.of(costmap_params(params, radius), side)
        return PlanningTables(
            block=block,
            costs=inflation.cost_of_squared,
            weights=step_weights(COST_WEIGHT, False),
            inflation=inflation.reach,
            radius=max(1, math.floor(radius / side + 1e-9)),
            same_obstacle=round(params.same_obstacle / side),
            marking_range=params.marking_range,
            max_extent=max(2, round(params.max_extent / side)),
            views=tuple(int(distance / side + 1e-9) for distance in params.view_distances),
            detour=round(params.detour / side * STRAIGHT * SCALE),
            first_limit=round(FIRST_LIMIT / side * STRAIGHT * SCALE),
            view_reach=max(1, round(min(params.view_range, robot.lidar.range_max) / side)),
            heading_steps=max(1, round(params.heading_distance / side)),
            robot_radius=radius,
        )

    return tuple(map(tables, (robot.radius + params.padding, *(k * robot.radius for k in params.tight_radii))))
