"""Costmaps as in Nav2: traversal costs for the robot's centre."""

import math
from dataclasses import dataclass

import numpy as np
import pydantic
from pydantic import NonNegativeFloat, PositiveFloat

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OCCUPIED_FROM, OccupancyGrid
from lidarnaut.envs.geometry.distance_transform import squared_distances

COST_FREE = 0
"""Cost of a cell outside the inflation radius of all obstacles."""
COST_MAX_FREE = 252
"""Highest cost of a collision-free cell."""
COST_INSCRIBED = 253
"""Cost of a cell that puts the robot's footprint in collision."""
COST_LETHAL = 254
"""Cost of an occupied cell."""
COST_UNKNOWN = 255
"""Cost of an unobserved cell beyond the footprint radius of known obstacles."""


@pydantic.dataclasses.dataclass(frozen=True, slots=True)
class CostmapParams:
    """Parameters of obstacle inflation. Defaults are those of Nav2's bring-up file."""

    robot_radius: PositiveFloat = 0.22
    """Radius of the robot's circular footprint [m]."""
    inflation_radius: float = 0.7
    """Distance from obstacles within which costs increase [m]."""
    cost_scaling_factor: NonNegativeFloat = 3.0
    """Exponential decay rate of the cost with distance [1/m]."""

    def __post_init__(self) -> None:
        if not self.inflation_radius >= self.robot_radius:
            raise ValueError(f"inflation_radius must be at least robot_radius, got {self.inflation_radius}")

    def reach(self, resolution: float) -> int:
        """Return the inflation radius in cells of side `resolution` [m]. Raise ValueError outside 1 to 180 cells."""
        reach = math.floor(self.inflation_radius / resolution + 1e-9)
        if not 1 <= reach <= 180:
            given = f"{self.inflation_radius} m at {resolution} m a cell"
            raise ValueError(f"inflation_radius must span 1 to 180 cells, got {given}")
        return reach

    def table(self, resolution: float) -> np.ndarray:
        """Return Nav2's cost for each squared distance to the nearest obstacle [cells2], uint8."""
        # Rounded: five cells of 0.05 m are exactly 0.25 m.
        distances = np.round(np.sqrt(np.arange((self.reach(resolution) + 1) ** 2 + 1)) * resolution, 9)
        costs = COST_MAX_FREE * np.exp(-self.cost_scaling_factor * (distances - self.robot_radius))
        costs[distances <= self.robot_radius] = COST_INSCRIBED
        costs[distances > self.inflation_radius] = COST_FREE
        costs[0] = COST_LETHAL
        return costs.astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Costmap:
    """Traversal cost of each cell of an occupancy grid."""

    costs: np.ndarray
    """Costs, shape (height, width), uint8: 0 free, 1..252 inflated, 253 inscribed, 254 lethal, 255 unknown."""
    grid: OccupancyGrid
    params: CostmapParams


@njit(cache=True, error_model="numpy")
def inflate(data, reach, table):
    """Convert occupancy to traversal costs: shape (height, width), int8 to uint8.

    `reach`: inflation radius [cells]. `table`: costs from `CostmapParams.table`.
    """
    height, width = data.shape
    squared = squared_distances(data >= OCCUPIED_FROM, reach)
    limit = np.uint16(len(table) - 1)
    costs = np.empty((height, width), dtype=np.uint8)
    for row in range(height):
        for col in range(width):
            cost = table[min(squared[row, col], limit)]
            costs[row, col] = COST_UNKNOWN if data[row, col] < 0 and cost < COST_INSCRIBED else cost
    return costs


def make_costmap(grid: OccupancyGrid, params: CostmapParams) -> Costmap:
    """Compute a costmap from an occupancy grid.

    Unobserved cells stay unknown beyond the footprint radius of known obstacles.
    """
    return Costmap(inflate(grid.data, params.reach(grid.resolution), params.table(grid.resolution)), grid, params)
