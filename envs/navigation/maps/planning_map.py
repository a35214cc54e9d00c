"""Map for path planning: costs and frontiers, updated in rectangles of changed cells."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.estimation.scan_points import ScanGeometry, project_hits, scan_ends
from lidarnaut.envs.geometry import NO_WINDOW, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D, Window
from lidarnaut.envs.geometry.occupancy_grid import known_window
from lidarnaut.envs.navigation.maps.planning_params import PlanningParams
from lidarnaut.envs.robots import LidarParams, RobotParams

from ..frontiers.frontiers import TILE, ignore_around, is_frontier_near, update_frontier
from ..search.astar import COST_WEIGHT, SCALE, STRAIGHT, new_expansion, step_weights
from .costmap import COST_UNKNOWN, Costmap, CostmapParams
from .obstacles import NO_POINTS
from .planning_kernels import cells_of, clear_beams, join_cells, mark, obstacle_cells, update_costs

SAME_OBSTACLE = 0.15
"""Scanned obstacles within this distance of an occupied map cell count as already mapped [m]."""
VIEW_DETOUR, VIEW_RANGE = 3.0, 8.0
"""Additional path cost accepted for a viewpoint nearer to the frontier, and maximum radius for counting unknown area in
view of a viewpoint [m]."""
HEADING_DISTANCE = 0.6
"""The heading change to a frontier is measured at this distance along its path [m]; an input of policies."""
FIRST_LIMIT = 16.0
"""Initial path cost limit in the search for reachable frontiers [m], doubled as needed."""


class PlanningTables(NamedTuple):
    """Planning parameters for one footprint radius, converted to cells and integer path costs."""

    costs: np.ndarray
    weights: np.ndarray
    inflation: int
    radius: int
    same_obstacle: int
    max_extent: int
    views: tuple[int, ...]
    detour: int
    first_limit: int
    view_reach: int
    heading_steps: int
    robot_radius: float


def _tables(params: PlanningParams, robot: RobotParams, side: float, radius: float) -> PlanningTables:
    costmap = params.costmap(radius)
    return PlanningTables(
        costs=costmap.table(side),
        weights=step_weights(COST_WEIGHT, False),
        inflation=costmap.reach(side),
        radius=max(1, math.floor(radius / side + 1e-9)),
        same_obstacle=round(SAME_OBSTACLE / side),
        max_extent=max(2, round(params.max_extent / side)),
        views=tuple(int(distance / side + 1e-9) for distance in params.view_distances),
        detour=round(VIEW_DETOUR / side * STRAIGHT * SCALE),
        first_limit=round(FIRST_LIMIT / side * STRAIGHT * SCALE),
        view_reach=max(1, round(min(VIEW_RANGE, robot.lidar.range_max) / side)),
        heading_steps=max(1, round(HEADING_DISTANCE / side)),
        robot_radius=radius,  # footprint radius [m]
    )


class CostLayer:
    """Costmap for one footprint radius, with cell weights for path search."""

    def __init__(self, tables: PlanningTables, params: CostmapParams, shape: tuple[int, int]) -> None:
        self.tables, self.params = tables, params
        self.costs = np.full(shape, COST_UNKNOWN, dtype=np.uint8)
        self.open_weights = np.zeros((shape[0] + 2) * (shape[1] + 2), dtype=np.uint8)
        """Weight of each cell in path search (see `step_weights`), uint8; flat raster with a border of one cell."""
        self.pending = NO_WINDOW
        """Rectangle of cells with outdated costs."""
        self.in_sight = NO_WINDOW
        """Rectangle of cells whose costs depend on obstacles visible at the last update."""


class PlanningMap:
    """Map for path planning: traversal costs and frontiers, with Nav2's layers for map, obstacles and inflation.

    Unlike in Nav2, obstacles within `SAME_OBSTACLE` of occupied map cells are not marked, so pose errors do not close
    doors. Beams clear marked obstacles, never the map.
    """

    def __init__(self, robot: RobotParams, resolution: float, params: PlanningParams = PlanningParams()) -> None:
        """Create a planning map; `resolution`: side of a map cell [m]."""
        self.params = params
        self.block = max(1, min(round(params.cell / resolution), int(robot.radius / resolution)))
        """Number of map cells along the side of a planning cell."""
        self.side = self.block * resolution
        """Side of a planning cell (block of map cells) [m]."""
        radii = robot.radius + params.padding, *(share * robot.radius for share in params.tight_radii)
        self.tables = tuple(_tables(params, robot, self.side, radius) for radius in radii)
        """Planning parameters for each footprint radius: the padded robot, then smaller footprints."""
        self._data: np.ndarray | None = None
        self._pending = self._known = NO_WINDOW
        self._beyond, self._points = 0.0, np.zeros((1, 2))
        self.occupancy = self.marks = np.empty((0, 0), dtype=np.int8)
        self.ignored_points = NO_POINTS
        """Centres of ignored frontier cells, shape (m, 2), float64, map frame [m]."""
        self.origin = (0.0, 0.0)
        """Corner of cell (0, 0) (x, y), map frame [m]."""

    def update(self, grid: OccupancyGrid, window: Window | None, *, redrawn: bool = False) -> None:
        """Note which cells of the occupancy grid have changed.

        `window`: rectangle of these cells; None for none. `redrawn`: the whole map was rebuilt; discard marked
        obstacles.
        """
        if redrawn or grid.data is not self._data:
            self._rebuild(grid, redrawn)
        elif window is not None:
            changed = window.blocks(self.block).dilated(0, self._size)
            self._pending = changed.shifted(*self._corner).union(self._pending)

    @property
    def _size(self) -> tuple[int, int]:
        assert self._data is not None
        rows, cols = self._data.shape
        return -(-rows // self.block), -(-cols // self.block)

    def reach_beyond(self, points: Sequence[tuple[float, float]], margin: float) -> None:
        """Surround the map and `points` (x, y) by unknown space, `margin` [m] wide, at the next `update`."""
        self._beyond, self._points, self._data = margin, np.array(points), None

    def refresh(self) -> None:
        """Update occupancy and frontier where map changes were recorded."""
        window, self._pending = self._pending, NO_WINDOW
        if window.is_empty:
            return
        assert self._data is not None
        top, left = self._corner
        join_cells(self._data, self.block, self.occupancy[top:, left:], window.shifted(-top, -left))
        update_frontier(self.occupancy, self.ignored, self.frontier, self.tile_counts, self._dilated(window, 1))
        self._invalidate(window)

    def layer(
        self, level: int, pose: Pose2D, obstacles: np.ndarray = NO_POINTS, bodies: np.ndarray = NO_POINTS
    ) -> CostLayer:
        """Return costmap and path search weights for a footprint radius, including visible obstacles.

        `level`: index of the radius, in `tables`. `obstacles`: scanned points, ignored near occupied map
        cells. `bodies`: obstacle points that are never ignored. Both: shape (n, 2), float64, base frame [m].
        """
        self.refresh()
        tables = self.tables[level]
        if level not in self._layers:
            self._layers[level] = CostLayer(tables, self.params.costmap(tables.robot_radius), self.occupancy.shape)
            self._layers[level].pending = self._dilated(self._known, tables.inflation)
        layer = self._layers[level]
        frame = self.params.marking_range, tuple(pose), self.origin, self.side
        missed, unmapped = obstacle_cells(obstacles, *frame), obstacle_cells(bodies, *frame)
        in_sight = NO_WINDOW
        for found in (missed, unmapped):
            if len(found):
                window = Window.spanning(found.min(axis=0).tolist(), found.max(axis=0).tolist())
                in_sight = self._dilated(window, tables.inflation).union(in_sight)
        window = layer.pending.union(layer.in_sight).union(in_sight)
        layer.pending, layer.in_sight = NO_WINDOW, in_sight
        if not window.is_empty:
            arrays = layer.costs, layer.open_weights
            update_costs(self.occupancy, self.marks, missed, unmapped, tables, *arrays, window)
        return layer

    @property
    def grid(self) -> OccupancyGrid:
        """Occupancy grid of the planning cells (blocks of map cells)."""
        return OccupancyGrid(self.occupancy, self.side, self.origin)

    def costmap(self, level: int, pose: Pose2D, *points: np.ndarray) -> Costmap:
        """Return the costmap for a footprint radius, including visible obstacles; arguments as for `layer`."""
        layer = self.layer(level, pose, *points)
        return Costmap(layer.costs, self.grid, layer.params)

    def integrate(self, pose: Pose2D, ranges: np.ndarray, lidar: LidarParams) -> None:
        """Mark scanned obstacles that the map lacks; clear marked obstacles along beams.

        `pose`: base pose, map frame. `ranges`: shape (num_beams,) [m]; inf for no return, NaN for ignored beams.
        ValueError if the pose is not finite, or the number of ranges is wrong.
        """
        if not all(map(math.isfinite, pose)):
            raise ValueError(f"pose must be finite, got {tuple(pose)}")
        if ranges.shape != (lidar.num_beams,):
            raise ValueError(f"ranges must have shape ({lidar.num_beams},), got {ranges.shape}")
        self.refresh()
        geometry, points = ScanGeometry.of(lidar), np.empty((2, lidar.num_beams))
        x, y, _ = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, 0.0))
        # A map cell of margin, so that range noise does not clear walls.
        lengths = np.minimum(ranges.astype(np.float64) - self.side / self.block, self.params.clearing_range)
        ends = pose.transform(scan_ends(lengths, geometry)[lengths > 0.0])
        clear_beams(self.marks, (x, y), ends, self.origin, self.side)
        near = geometry._replace(range_max=min(self.params.marking_range, lidar.range_max))
        count = project_hits(ranges, near, points)
        self.mark(pose.transform(points[:, :count].T))
        self._invalidate(self._window_around(x, y, self.params.clearing_range))

    def mark(self, points: np.ndarray) -> None:
        """Mark obstacle points that no scan shows, such as contacts, shape (n, 2), map frame [m]."""
        self.refresh()
        mark(self.marks, self.occupancy, cells_of(points, *self.origin, self.side), self.tables[0].same_obstacle)
        if len(points):
            x, y = (0.5 * (points.min(axis=0) + points.max(axis=0))).tolist()
            self._invalidate(self._window_around(x, y, 0.5 * float(np.ptp(points, axis=0).max()) + self.side))

    def clear_marks(self, center: tuple[float, float] = (0.0, 0.0), radius: float = math.inf) -> None:
        """Clear obstacles marked by scans in a square around (x, y), map frame; by default all.

        `radius`: half side of the square [m].
        """
        window = self._window_around(*center, radius)
        self.marks[window.slices] = UNKNOWN
        self._invalidate(window)

    def ignore(self, points: np.ndarray) -> None:
        """Exclude cells at points, shape (n, 2), float64, map frame [m], and their neighbours from the frontier."""
        self.ignored_points = np.concatenate([self.ignored_points, points])
        ignore_around(self.ignored, self.frontier, self.tile_counts, cells_of(points, *self.origin, self.side))

    def look_again_at(self, points: np.ndarray) -> None:
        """Stop ignoring frontier cells at points, shape (n, 2), map frame [m], from the next `update` on."""
        is_given = (self.ignored_points[:, None] == points[None]).all(axis=2).any(axis=1)
        if is_given.any():
            self.ignored_points, self._data = self.ignored_points[~is_given], None

    def is_frontier_near(self, point: tuple[float, float], radius: float) -> bool:
        """Return True if a frontier cell is within `radius` [m] of a point (x, y), map frame [m]."""
        reach = math.ceil(radius / self.side - 1e-9)
        return bool(is_frontier_near(self._data, self.block, self.ignored, *self.cell(*point), reach))

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the raster cell (row, column) of a position, map frame [m]; possibly outside."""
        return math.floor((y - self.origin[1]) / self.side), math.floor((x - self.origin[0]) / self.side)

    def _rebuild(self, grid: OccupancyGrid, redrawn: bool) -> None:
        marked = NO_POINTS if redrawn else self.grid.centers(np.argwhere(self.marks == OCCUPIED))
        self._data = grid.data
        top = left = above = right = 0
        if self._beyond > 0.0:
            (x0, y0, x1, y1), (x, y) = grid.bounds, self._points.T
            gaps = np.maximum((y0 - min(y), x0 - min(x), max(y) - y1, max(x) - x1), 0.0)
            top, left, above, right = np.rint((gaps + self._beyond) / self.side).astype(int).tolist()
        self._corner, shape = (top, left), (top + self._size[0] + above, left + self._size[1] + right)
        self.origin = grid.origin[0] - left * self.side, grid.origin[1] - top * self.side
        self.occupancy = np.full(shape, UNKNOWN, dtype=np.int8)
        self.marks = np.full(shape, UNKNOWN, dtype=np.int8)
        """Obstacles marked by scans, shape (height, width), int8: 100 obstacle, 0 free, -1 unobserved."""
        mark(self.marks, self.occupancy, cells_of(marked, *self.origin, self.side), -1)
        self.frontier = np.zeros(shape, dtype=np.bool_)
        self.tile_counts = np.zeros((shape[0] // TILE + 1, shape[1] // TILE + 1), dtype=np.int32)
        self.ignored = np.zeros(shape, dtype=np.bool_)
        ignored = cells_of(self.ignored_points, *self.origin, self.side)
        ignore_around(self.ignored, self.frontier, self.tile_counts, ignored)
        self._layers: dict[int, CostLayer] = {}
        self.expansion = new_expansion(*shape)
        self.queue = np.empty((1024, 2), dtype=np.int32)
        self._pending = known_window(grid.data).blocks(self.block).shifted(top, left)
        self._known = NO_WINDOW
        if len(marked):
            first, last = (self.cell(*corner.tolist()) for corner in (marked.min(axis=0), marked.max(axis=0)))
            self._known = Window.spanning(first, last)

    def _invalidate(self, window: Window) -> None:
        self._known = window.union(self._known)  # marks lie in unknown space as well
        for layer in self._layers.values():
            layer.pending = self._dilated(window, layer.tables.inflation).union(layer.pending)

    def _window_around(self, x: float, y: float, radius: float) -> Window:
        if math.isinf(radius):
            return Window(0, 0, *self.occupancy.shape)
        window = Window.spanning(self.cell(x - radius, y - radius), self.cell(x + radius, y + radius))
        return self._dilated(window, 1)

    def _dilated(self, window: Window, reach: int) -> Window:
        return window.dilated(reach, self.occupancy.shape)
