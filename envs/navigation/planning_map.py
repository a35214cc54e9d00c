"""The map as planners see it: joined cells, frontier cells and costs, kept up to date where the map has changed.

What an update costs grows with the window that the scans since the last one have touched, and not with the map. Only a
map that has grown, or changed as a whole, is looked at anew from end to end.
"""

import math

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation.astar import new_expansion
from envs.navigation.costmap import COST_UNKNOWN, Costmap, Window, known_window, union
from envs.navigation.frontiers import TILE, ignore_around, update_frontier
from envs.navigation.obstacles import NO_POINTS
from envs.navigation.params import PlanningParams
from envs.navigation.planning_kernels import cells_of, join_cells, obstacle_cells, update_costs
from envs.navigation.tables import PlanningTables, costmap_params, tables_of
from envs.navigation.viewpoints import is_frontier_near
from envs.robots import RobotParams

NO_CELLS = np.empty((0, 2), dtype=np.int64)
"""What `obstacle_cells` returns where there are no points."""


class CostLayer:
    """Costs for the footprint of one padding level."""

    def __init__(self, tables: PlanningTables, shape: tuple[int, int]) -> None:
        """Start with a raster of unknown cells."""
        self.tables = tables
        self.costs = np.full(shape, COST_UNKNOWN, dtype=np.uint8)
        """Shape (height, width), uint8, as in `Costmap`."""
        self.open_weights = np.zeros((shape[0] + 2) * (shape[1] + 2), dtype=np.uint8)
        """Shape ((height + 2) * (width + 2),), uint8; see `expand`."""
        self.pending: Window | None = None
        """Where the map has changed since the last update, and what that reaches."""
        self._marked: Window | None = None


class PlanningMap:
    """Planning cells of one robot's map."""

    def __init__(self, robot: RobotParams, resolution: float, params: PlanningParams = PlanningParams()) -> None:
        """Prepare for maps with cells of a side of `resolution` [m]."""
        self.params = params
        self.tables = tables_of(params, robot, resolution)
        """One per footprint padding level."""
        self.block = self.tables[0].block
        """Side of a planning cell [map cells]."""
        self.side = self.block * resolution
        """Side of a planning cell [m]."""
        self.reset()

    def reset(self) -> None:
        """Forget the map, and what was ignored in it."""
        self._data: np.ndarray | None = None
        self._pending: Window | None = None
        self._known: Window | None = None
        self.ignored_points = NO_POINTS
        """Shape (m, 2), float64: frontier cells that are ignored, with their neighbours, map frame [m]."""
        self.origin = (0.0, 0.0)
        """Where the first column and the first row begin, map frame [m]."""

    def update(self, grid: OccupancyGrid, window: tuple[int, int, int, int] | None, *, redrawn: bool = False) -> None:
        """Take note of what the last scan has changed; to be called after each.

        Args:
            grid: the map.
            window: first column and row, last column and row of the map cells that may have changed; None for none.
            redrawn: whether the map changed as a whole.
        """
        if redrawn or grid.data is not self._data:
            self._rebuild(grid)
        elif window is not None:
            block, (height, width) = self.block, self.joined.shape
            col, row, last_col, last_row = (k // block for k in window)
            changed = max(row, 0), max(col, 0), min(last_row + 1, height), min(last_col + 1, width)
            if changed[0] < changed[2] and changed[1] < changed[3]:
                self._pending = union(self._pending, changed)

    def refresh(self) -> None:
        """Bring joined cells and frontier up to date."""
        window, self._pending = self._pending, None
        if window is None:
            return
        assert self._data is not None
        join_cells(self._data, self.block, self.joined, window)
        update_frontier(self.joined, self.ignored, self.frontier, self.tile_counts, self._dilated(window, 1))
        self._known = union(self._known, window)
        for layer in self._layers.values():
            layer.pending = union(layer.pending, self._dilated(window, layer.tables.inflation))

    def layer(
        self, level: int, pose: Pose2D, obstacles: np.ndarray = NO_POINTS, bodies: np.ndarray = NO_POINTS
    ) -> CostLayer:
        """Return the costs of a footprint padding level, with the obstacles around the robot.

        Args:
            level: 0 for the padded footprint, up to `max_level` for the smallest.
            pose: of the robot, map frame.
            obstacles: shape (n, 2), float64, base frame [m]: what the map may miss.
            bodies: shape (m, 2), float64, base frame [m]: what no occupied cell of the map can account for.
        """
        self.refresh()
        tables = self.tables[level]
        if level not in self._layers:
            self._layers[level] = CostLayer(tables, self.joined.shape)
            if self._known is not None:
                self._layers[level].pending = self._dilated(self._known, tables.inflation)
        layer = self._layers[level]
        frame = tables.marking_range, tuple(pose), self.origin, self.side
        missed = obstacle_cells(obstacles, *frame) if len(obstacles) else NO_CELLS
        unmapped = obstacle_cells(bodies, *frame) if len(bodies) else NO_CELLS
        marked: Window | None = None
        for found in (missed, unmapped):
            if len(found):
                (row, col), (last_row, last_col) = found.min(axis=0).tolist(), found.max(axis=0).tolist()
                marked = union(marked, self._dilated((row, col, last_row + 1, last_col + 1), tables.inflation))
        window = union(union(layer.pending, layer._marked), marked)
        layer.pending, layer._marked = None, marked
        if window is not None and window[0] < window[2] and window[1] < window[3]:
            update_costs(self.joined, missed, unmapped, tables, layer.costs, layer.open_weights, window)
        return layer

    @property
    def max_level(self) -> int:
        """The greatest footprint padding level."""
        return len(self.tables) - 1

    @property
    def grid(self) -> OccupancyGrid:
        """The planning cells as a map."""
        return OccupancyGrid(self.joined, self.side, self.origin)

    def costmap(
        self, level: int, pose: Pose2D, obstacles: np.ndarray = NO_POINTS, bodies: np.ndarray = NO_POINTS
    ) -> Costmap:
        """Return `layer` as a costmap; its array is live."""
        layer = self.layer(level, pose, obstacles, bodies)
        return Costmap(layer.costs, self.grid, costmap_params(self.params, layer.tables.robot_radius))

    def ignore(self, points: np.ndarray) -> None:
        """Ignore frontier cells (shape (n, 2), float64, map frame [m]) and their neighbours from now on."""
        self.ignored_points = np.concatenate([self.ignored_points, points])
        ignore_around(self.ignored, self.frontier, self.tile_counts, cells_of(points, *self.origin, self.side))

    def is_frontier_near(self, point: tuple[float, float], radius: float) -> bool:
        """Tell whether there is a frontier cell within `radius` [m] of a point (x, y), map frame [m]."""
        assert self._data is not None
        reach = math.ceil(radius / self.side - 1e-9)
        return bool(is_frontier_near(self._data, self.block, self.ignored, *self.cell(*point), reach))

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the planning cell (row, column) of a position, map frame [m]; may lie outside."""
        return math.floor((y - self.origin[1]) / self.side), math.floor((x - self.origin[0]) / self.side)

    def _rebuild(self, grid: OccupancyGrid) -> None:
        """Look at a map anew, from end to end."""
        rows, cols = grid.data.shape
        shape = -(-rows // self.block), -(-cols // self.block)
        self._data, self.origin = grid.data, grid.origin
        self.joined = np.full(shape, -1, dtype=np.int8)
        """Shape (height, width), int8, occupancy; unknown where no map cell is known."""
        self.frontier = np.zeros(shape, dtype=np.bool_)
        """Shape (height, width), bool: frontier cells."""
        self.tile_counts = np.zeros((shape[0] // TILE + 1, shape[1] // TILE + 1), dtype=np.int32)
        self.ignored = np.zeros(shape, dtype=np.bool_)
        """Shape (height, width), bool: cells that count as no frontier."""
        ignore_around(
            self.ignored, self.frontier, self.tile_counts, cells_of(self.ignored_points, *self.origin, self.side)
        )
        self._layers: dict[int, CostLayer] = {}
        self.expansion = new_expansion(*shape)
        """Workspace of searches."""
        self.entries = np.empty((1024, 2), dtype=np.int32)
        """Queue of searches."""
        top, left, bottom, right = (k // self.block for k in known_window(grid.data))
        self._pending, self._known = (top, left, bottom + 1, right + 1), None

    def _dilated(self, window: Window, reach: int) -> Window:
        """Return a window and `reach` cells around it, as far as they lie in the raster."""
        height, width = self.joined.shape
        top, left, bottom, right = window
        return max(top - reach, 0), max(left - reach, 0), min(bottom + reach, height), min(right + reach, width)
