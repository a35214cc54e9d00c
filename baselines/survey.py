"""What a belief says about travel."""

from functools import cached_property

import numpy as np

from envs.geometry import OCCUPIED, OccupancyGrid, Pose2D
from envs.navigation import (
    Costmap,
    CostmapParams,
    TravelField,
    crop_to_known,
    frontier_mask,
    make_costmap,
    mark_missing,
    travel_field,
)
from envs.slam import Belief

SAME_OBSTACLE = 0.15
"""Distance up to which an occupied cell of the map accounts for an obstacle in the scan [m]."""


class Survey:
    """What the map says about travel from where the robot believes to be. Parts are computed when first asked for."""

    def __init__(
        self,
        belief: Belief,
        params: CostmapParams,
        obstacles: np.ndarray | None = None,
        bodies: np.ndarray | None = None,
    ) -> None:
        """Look at a belief; nothing of it is kept alive but the array behind the map.

        Args:
            belief: what the robot believes.
            params: how obstacles spread.
            obstacles: shape (n, 2), float64, base frame [m]: what stands in the way though the map may not say so.
            bodies: shape (m, 2), float64, base frame [m]: the same of what no occupied cell of the map can account for.
        """
        self.pose: Pose2D = belief.pose
        self.grid: OccupancyGrid = crop_to_known(belief.grid)
        self._params = params
        self._obstacles = np.empty((0, 2)) if obstacles is None else self.pose.transform(obstacles)
        self._bodies = np.empty((0, 2)) if bodies is None else self.pose.transform(bodies)

    @cached_property
    def costmap(self) -> Costmap:
        """Costs of the observed part of the map, with the obstacles that it misses."""
        grid = self.grid
        reach = round(SAME_OBSTACLE / grid.resolution)
        marked = mark_missing(grid.data, grid.cells(self._obstacles), reach, self._params.occupied_from)
        bodies = grid.cells(self._bodies)
        bodies = bodies[grid.contains(bodies)]
        marked[bodies[:, 0], bodies[:, 1]] = OCCUPIED
        return make_costmap(OccupancyGrid(marked, grid.resolution, grid.origin), self._params)

    @cached_property
    def frontier(self) -> np.ndarray:
        """Frontier cells, shape of the grid, bool."""
        return frontier_mask(self.grid)

    @cached_property
    def field(self) -> TravelField | None:
        """Ways from the robot to everywhere through known space."""
        return travel_field(self.costmap, self.pose[:2])
