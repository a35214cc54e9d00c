"""The numbers that surveys need, as Numba takes them."""

import math
from typing import NamedTuple

import numpy as np

from envs.frontier_choice.params import SurveyParams
from envs.navigation.astar import step_weights
from envs.navigation.costmap import CostmapParams, Inflation
from envs.robots import RobotParams

OCCUPIED_FROM = 50
"""Least occupancy that is an obstacle [percent]."""
COST_WEIGHT = 3.0
"""How many times its length a step over the dearest free cell costs more than one over a free one."""


class SurveyTables(NamedTuple):
    """Robot and `SurveyParams` in planning cells, as Numba takes them."""

    block: int
    """Side of a planning cell [map cells]."""
    costs: np.ndarray
    """Shape (n,), uint8: cost by the squared distance to the nearest obstacle [cells2]."""
    weights: np.ndarray
    """Shape (256,), uint8, see `step_weights`."""
    inflation: int
    """Distance up to which nearness to an obstacle costs [cells]."""
    radius: int
    """How far from its cell the robot may be taken to stand [cells]."""
    same_obstacle: int
    """[cells]"""
    marking_range: float
    """[m]"""
    max_extent: int
    """[cells]"""
    views: tuple[int, ...]
    """View distances [cells]."""
    gain_radius: float
    """[cells]"""
    heading_steps: int
    """[cells]"""

    @classmethod
    def of(cls, params: SurveyParams, robot_radius: float, block: int, resolution: float) -> "SurveyTables":
        """Collect the numbers for a robot of a radius [m] on a map with cells of a side [m]."""
        side = block * resolution
        spread = CostmapParams(robot_radius, robot_radius + params.inflation, params.cost_scaling_factor, OCCUPIED_FROM)
        inflation = Inflation.of(spread, side)
        return cls(
            block=block,
            costs=inflation.cost_of_squared,
            weights=step_weights(COST_WEIGHT, False),
            inflation=inflation.reach,
            radius=max(1, math.floor(robot_radius / side + 1e-9)),
            same_obstacle=round(params.same_obstacle / side),
            marking_range=params.marking_range,
            max_extent=max(2, round(params.max_extent / side)),
            views=tuple(int(distance / side + 1e-9) for distance in params.view_distances),
            gain_radius=params.gain_radius / side,
            heading_steps=max(1, round(params.heading_distance / side)),
        )


def tables_of(params: SurveyParams, robot: RobotParams, resolution: float) -> tuple[SurveyTables, ...]:
    """Return the tables to try in turn: for the padded robot, then for smaller ones."""
    block = max(1, min(round(params.cell / resolution), int(robot.radius / resolution)))
    radii = robot.radius + params.padding, *(share * robot.radius for share in params.tight_radii)
    return tuple(SurveyTables.of(params, radius, block, resolution) for radius in radii)
