"""Paths on a costmap: extraction, shortcuts, smoothing and validity checks."""

import math
from dataclasses import dataclass

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.lines import resample
from lidarnaut.envs.geometry.rows import write_row

from ..maps.costmap import COST_INSCRIBED, COST_LETHAL, COST_MAX_FREE, COST_UNKNOWN, Costmap
from ..maps.obstacles import free_distance
from .astar import COST_WEIGHT, NO_GOAL, NO_STEP, SCALE, STEPS, STRAIGHT, UNREACHED, begin, expand, search, step_weights

SHORTCUT = 4.0
"""Maximum length of a straight line that replaces a stretch of a path [m]."""
MAX_POINTS = 1024
DATA_WEIGHT = 0.2
"""Weight of each point's original position in path smoothing (Nav2's `w_data`)."""
SMOOTH_WEIGHT = 0.3
"""Weight of the midpoint of a point's neighbours in path smoothing (Nav2's `w_smooth`)."""
NUM_SWEEPS = 100
NUM_EXITS = 32
"""Number of directions tried for a straight path out of a mapped obstacle."""
SMOOTH_TOLERANCE = 1e-4
"""Displacement of path points below which path smoothing stops [m]."""


@njit(cache=True, error_model="numpy")
def walk_back(predecessor, row, col):
    """Return the path cells from the start of a search to (row, col), shape (n, 2), int64."""
    length = 1
    r, c = row + 1, col + 1
    while predecessor[r, c] != NO_STEP:
        d_row, d_col = STEPS[predecessor[r, c]]
        r, c = r - d_row, c - d_col
        length += 1
    cells = np.empty((length, 2), dtype=np.int64)
    r, c = row + 1, col + 1
    for k in range(length - 1, -1, -1):
        cells[k, 0], cells[k, 1] = r - 1, c - 1
        if k:
            d_row, d_col = STEPS[predecessor[r, c]]
            r, c = r - d_row, c - d_col
    return cells


@njit(cache=True, error_model="numpy")
def _line_cost(costs, weights, row0, col0, row1, col1):
    d_row, d_col = row1 - row0, col1 - col0
    length = math.hypot(d_row, d_col)
    # Four samples per cell skip at most a corner's tip.
    num_samples = max(1, math.ceil(4.0 * length))
    total = 0.0
    for k in range(num_samples):
        t = (k + 0.5) / num_samples
        cost = costs[math.floor(row0 + t * d_row + 0.5), math.floor(col0 + t * d_col + 0.5)]
        if weights[cost] == 0 or cost == COST_INSCRIBED:
            return -1.0
        total += weights[cost]
    return STRAIGHT * length * total / num_samples


@njit(cache=True, error_model="numpy")
def shorten(costs, weights, travel, cells, reach):
    """Replace stretches of a path, up to `reach` cells long, by straight lines that cost no more.

    `travel`: path costs, with a border of one cell. `cells`: path, shape (n, 2), int64. Returns the corners and both
    ends, shape (m, 2), int64.
    """
    kept = np.empty_like(cells)
    write_row(kept[0], cells[0])
    num_kept = 1
    i = 0
    while i < len(cells) - 1:
        j = min(i + reach, len(cells) - 1)
        while j > i + 1:
            line = _line_cost(costs, weights, cells[i, 0], cells[i, 1], cells[j, 0], cells[j, 1])
            walk = travel[cells[j, 0] + 1, cells[j, 1] + 1] - travel[cells[i, 0] + 1, cells[i, 1] + 1]
            if 0.0 <= line <= walk:
                break
            j -= 1
        write_row(kept[num_kept], cells[j])
        num_kept += 1
        i = j
    return kept[:num_kept]


@njit(cache=True, error_model="numpy")
def nearest_cell(costs, weights, row, col, reach, max_cost):
    """Return the cell nearest to (row, col), within `reach` cells, of cost at most `max_cost`; (-1, -1) for none.

    Unknown cells count if `weights` allows them.
    """
    height, width = costs.shape
    best_row, best_col, best = -1, -1, reach * reach + 1
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for c in range(max(col - reach, 0), min(col + reach + 1, width)):
            squared = (r - row) ** 2 + (c - col) ** 2
            cost = costs[r, c]
            if squared < best and weights[cost] > 0 and (cost <= max_cost or cost == COST_UNKNOWN):
                best_row, best_col, best = r, c, squared
    return best_row, best_col


@njit(cache=True, error_model="numpy")
def write_path(costs, weights, expansion, cell, side, origin):
    """Return the path to a cell reached by a search, points at most half a cell apart, shape (n, 2), map frame [m].

    `side`: cell side [m]. `origin`: raster origin, map frame [m]. Paths are cut off after `MAX_POINTS`.
    """
    left, low = origin
    shape = (costs.shape[0] + 2, costs.shape[1] + 2)
    travel, predecessor = expansion.travel.reshape(shape), expansion.predecessor.reshape(shape)
    reach = max(2, round(SHORTCUT / side))
    corners = shorten(costs, weights, travel, walk_back(predecessor, cell[0], cell[1]), reach)
    path = np.empty((MAX_POINTS, 2))
    path[0, 0], path[0, 1] = left + (corners[0, 1] + 0.5) * side, low + (corners[0, 0] + 0.5) * side
    count = 1
    for k in range(1, corners.shape[0]):
        x0, y0 = left + (corners[k - 1, 1] + 0.5) * side, low + (corners[k - 1, 0] + 0.5) * side
        dx, dy = (corners[k, 1] - corners[k - 1, 1]) * side, (corners[k, 0] - corners[k - 1, 0]) * side
        num_steps = math.ceil(2.0 * math.hypot(dx, dy) / side - 1e-9)
        for step in range(1, num_steps + 1):
            if count == MAX_POINTS:
                return path
            path[count, 0], path[count, 1] = x0 + dx * step / num_steps, y0 + dy * step / num_steps
            count += 1
    return path[:count].copy()


@njit(cache=True, error_model="numpy")
def search_goal(layer, weights, expansion, queue, start, goal, slack):
    """Search for the cheapest path to a goal cell, or to the nearest free cell at most `slack` cells away.

    Returns the end cell, (-1, -1) without a path, and the search queue, perhaps enlarged. `layer`: costmap and cell
    weights.
    """
    costs, open_weights = layer
    row, col = nearest_cell(costs, weights, goal[0], goal[1], slack, COST_MAX_FREE)
    if row < 0:
        return (-1, -1), queue
    begin(expansion, queue, costs, start, (row, col))
    queue = expand(expansion, queue, open_weights, costs, weights, (row, col), np.int64(UNREACHED))
    if expansion.travel[(row + 1) * (costs.shape[1] + 2) + col + 1] == UNREACHED:
        return (-1, -1), queue
    return (row, col), queue


@dataclass(frozen=True, slots=True, eq=False)
class TravelField:
    """Cost-to-come of each costmap cell from a start."""

    costmap: Costmap
    weights: np.ndarray
    """Weight of each costmap value in path search, shape (256,), uint8; see `step_weights`."""
    travel: np.ndarray
    """Integer cost-to-come, shape (height + 2, width + 2), int32, with a border of one cell; `UNREACHED` without a
    path."""
    predecessor: np.ndarray
    """Last move of the path to each cell, uint8: index into the eight moves of `STEPS`, shape of `travel`."""

    @property
    def costs(self) -> np.ndarray:
        """Cost-to-come of each cell, shape (height, width), float32 [m]; inf without a path."""
        return self._metres(self.travel[1:-1, 1:-1]).astype(np.float32)

    def cost(self, cells: np.ndarray) -> np.ndarray:
        """Return the cost-to-come of cells, shape (...) [m]; inf without a path.

        `cells`: (row, column), shape (..., 2), int, inside the raster.
        """
        return self._metres(self.travel[cells[..., 0] + 1, cells[..., 1] + 1])

    def length(self, row: int, col: int) -> float:
        """Return the cost-to-come of a cell [m]; inf without a path, or outside the raster. For a cell, faster."""
        height, width = self.travel.shape
        if not (0 <= row < height - 2 and 0 <= col < width - 2):
            return math.inf
        travel = int(self.travel[row + 1, col + 1])
        return math.inf if travel == UNREACHED else travel * self._step

    @property
    def _step(self) -> float:
        return self.costmap.grid.resolution / (STRAIGHT * SCALE)

    def _metres(self, travel: np.ndarray) -> np.ndarray:
        return np.where(travel == UNREACHED, np.inf, travel * self._step)

    def path(self, row: int, col: int) -> np.ndarray | None:
        """Return the path to a cell, points a cell apart, shape (n, 2), float64 [m]; None without a path."""
        if self.travel[row + 1, col + 1] == UNREACHED:
            return None
        cells = walk_back(self.predecessor, row, col)
        grid = self.costmap.grid
        reach = max(2, round(SHORTCUT / grid.resolution))
        corners = shorten(self.costmap.costs, self.weights, self.travel, cells, reach)
        return resample(grid.centers(corners), grid.resolution)


def _traversable_cell(
    costmap: Costmap, weights: np.ndarray, point: tuple[float, float], tolerance: float, max_cost: int
) -> tuple[int, int] | None:
    row, col = (int(k) for k in costmap.grid.cells(np.array(point)))
    reach = math.floor(tolerance / costmap.grid.resolution + 1e-9)
    row, col = nearest_cell(costmap.costs, weights, row, col, reach, max_cost)
    return None if row < 0 else (row, col)


def travel_field(
    costmap: Costmap,
    start: tuple[float, float],
    *,
    goal: tuple[int, int] | None = None,
    allow_unknown: bool = False,
    cost_weight: float = COST_WEIGHT,
) -> TravelField | None:
    """Compute path costs from a position (x, y), map frame [m], to all cells of a costmap, or to one `goal` cell by A*.

    An untraversable start moves to the nearest traversable cell within the robot's radius; returns None without such a
    cell. With a goal, only costs on the path are final. Unknown cells, if allowed, cost as much as `COST_MAX_FREE`.
    """
    weights = step_weights(cost_weight, allow_unknown)
    cell = _traversable_cell(costmap, weights, start, costmap.params.robot_radius, COST_INSCRIBED)
    if cell is None:
        return None
    return TravelField(costmap, weights, *search(costmap.costs, weights, *cell, *(goal or NO_GOAL)))


def plan_path(
    costmap: Costmap,
    start: tuple[float, float],
    goal: tuple[float, float],
    *,
    tolerance: float = 0.0,
    allow_unknown: bool = False,
) -> np.ndarray | None:
    """Return the cheapest path between positions (x, y), map frame [m], by A*; None without a path.

    If the goal is in collision, the path may end up to `tolerance` [m] away. Unknown cells, if allowed, cost as much as
    `COST_MAX_FREE`. Returns points a cell apart, shape (n, 2), float64 [m].
    """
    cell = _traversable_cell(costmap, step_weights(COST_WEIGHT, allow_unknown), goal, tolerance, COST_MAX_FREE)
    if cell is None:
        return None
    field = travel_field(costmap, start, goal=cell, allow_unknown=allow_unknown)
    return None if field is None else field.path(*cell)


def exits(costmap: Costmap, pose: Pose2D, obstacles: np.ndarray, reach: float, least: float = 0.0) -> list[np.ndarray]:
    """Return straight paths out of a mapped obstacle that the robot overlaps, shortest first.

    The scan must show free space along a path. `obstacles`: scanned points, shape (k, 2), base frame [m]. `reach`,
    `least`: maximum and minimum path length [m]. Paths: shape (n, 2), points at most a cell apart, map frame [m]; none
    if the footprint is free.
    """
    grid, found = costmap.grid, []
    here = grid.cells(np.array(pose[:2]))
    if grid.contains(here) and costmap.costs[tuple(here)] <= COST_MAX_FREE:
        return []
    for angle in np.linspace(0.0, 2.0 * math.pi, NUM_EXITS, endpoint=False):
        ahead = Pose2D(0.0, 0.0, angle)
        free = free_distance(ahead.inverse().transform(obstacles), 0.0, costmap.params.robot_radius, reach)
        along = np.arange(0.0, free + 1e-9, grid.resolution)
        path = pose.compose(ahead).transform(np.column_stack([along, np.zeros_like(along)]))
        path, along = path[inside := grid.contains(grid.cells(path))], along[inside]
        is_open = costmap.costs[tuple(grid.cells(path).T)] <= COST_MAX_FREE
        ends = np.flatnonzero(is_open & (along >= least))
        if len(ends):
            found.append(path[: ends[0] + 1])
    return sorted(found, key=len)


@njit(cache=True, error_model="numpy")
def _relax(points, costs, origin_x, origin_y, resolution, allow_unknown):
    height, width = costs.shape
    smooth = points.copy()
    for _ in range(NUM_SWEEPS):
        largest = 0.0
        for k in range(1, points.shape[0] - 1):
            x, y = smooth[k]
            new_x = x + DATA_WEIGHT * (points[k, 0] - x) + SMOOTH_WEIGHT * (smooth[k - 1, 0] + smooth[k + 1, 0] - 2 * x)
            new_y = y + DATA_WEIGHT * (points[k, 1] - y) + SMOOTH_WEIGHT * (smooth[k - 1, 1] + smooth[k + 1, 1] - 2 * y)
            row, col = math.floor((new_y - origin_y) / resolution), math.floor((new_x - origin_x) / resolution)
            if row < 0 or col < 0 or row >= height or col >= width:
                continue
            cost = costs[row, col]
            if cost >= COST_INSCRIBED and not (cost == COST_UNKNOWN and allow_unknown):
                continue
            smooth[k, 0], smooth[k, 1] = new_x, new_y
            largest = max(largest, abs(new_x - x), abs(new_y - y))
        if largest < SMOOTH_TOLERANCE:
            break
    return smooth


def smooth_path(costmap: Costmap, path: np.ndarray, *, allow_unknown: bool = False) -> np.ndarray:
    """Smooth a path after Nav2's simple smoother. Points avoid collisions; both ends stay.

    `path`: points about a cell apart, shape (n, 2), n > 0 [m]. Returns points at most a cell apart, shape (m, 2),
    float64 [m].
    """
    grid = costmap.grid
    path = np.ascontiguousarray(path, dtype=np.float64)
    smooth: np.ndarray = _relax(path, costmap.costs, *grid.origin, grid.resolution, allow_unknown)
    return resample(smooth, grid.resolution)


def is_path_valid(costmap: Costmap, path: np.ndarray, *, allow_unknown: bool = False) -> bool:
    """Return True if a path stays inside the map and touches no known obstacle.

    `path`: points about a cell apart, shape (n, 2) [m]; may lead out of an initial collision.
    """
    grid = costmap.grid
    cells = grid.cells(path)
    if not grid.contains(cells).all():
        return False
    costs = costmap.costs[tuple(cells.T)]
    touches = (costs == COST_INSCRIBED) | (costs == COST_LETHAL)
    is_open = (step_weights(COST_WEIGHT, allow_unknown)[costs] > 0) & ~touches
    first = int(np.argmax(is_open))
    return bool(touches[:first].all() and is_open[first:].all())
