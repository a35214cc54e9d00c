"""Paths over a costmap, from the searches of `astar`."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from envs.geometry.polyline import resample
from envs.navigation.astar import COST_WEIGHT, NO_STEP, SCALE, STEPS, STRAIGHT, UNREACHED, search, step_weights
from envs.navigation.costmap import COST_INSCRIBED, COST_MAX_FREE, COST_UNKNOWN, Costmap

SHORTCUT = 4.0
"""Longest stretch of a path that one straight line replaces [m]."""


@njit(cache=True, error_model="numpy")
def walk_back(predecessor, row, col):
    """Return the cells from the start to (row, col), shape (n, 2), int64, in the frame of the unpadded raster."""
    length = 1
    r, c = row + 1, col + 1
    while predecessor[r, c] != NO_STEP:
        d_row, d_col = STEPS[predecessor[r, c]]
        r, c = r - d_row, c - d_col
        length += 1
    cells = np.empty((length, 2), dtype=np.int64)
    r, c = row + 1, col + 1
    for k in range(length - 1, -1, -1):
        cells[k] = r - 1, c - 1
        if k:
            d_row, d_col = STEPS[predecessor[r, c]]
            r, c = r - d_row, c - d_col
    return cells


@njit(cache=True, error_model="numpy")
def _line_cost(costs, weights, row0, col0, row1, col1):
    """Integrate the weights along the line between two cells' centres, in the units of `search`; -1 if blocked."""
    d_row, d_col = row1 - row0, col1 - col0
    length = math.hypot(d_row, d_col)
    # Four samples per cell do not step over more than the tip of a corner.
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
    """Replace stretches of a path by straight lines where those cost no more.

    Args:
        costs: shape (height, width), uint8.
        weights: shape (256,), uint8, see `step_weights`.
        travel: shape (height + 2, width + 2), int32, from the `search` that found the path.
        cells: shape (n, 2), int64, the path's cells.
        reach: greatest number of cells that one line replaces.

    Returns:
        Shape (m, 2), int64: the corners of the shorter path, with both of its ends.
    """
    kept = np.empty_like(cells)
    kept[0] = cells[0]
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
        kept[num_kept] = cells[j]
        num_kept += 1
        i = j
    return kept[:num_kept]


@njit(cache=True, error_model="numpy")
def nearest_cell(costs, weights, row, col, reach, max_cost):
    """Find the traversable cell nearest to (row, col), within `reach` cells.

    Cells that cost more than `max_cost` do not count; unknown ones do where `weights` lets them. Returns (-1, -1) if
    there is none.
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


@dataclass(frozen=True, slots=True, eq=False)
class TravelField:
    """Cost-to-come of every cell from a start, and the predecessors that lead there."""

    costmap: Costmap
    """Where it was computed."""
    weights: np.ndarray
    """Shape (256,), uint8, see `step_weights`."""
    travel: np.ndarray
    """Shape (height + 2, width + 2), int32, with a border of one cell; `UNREACHED` where there is no path."""
    predecessor: np.ndarray
    """Same shape, uint8: index into `STEPS` of the last step."""

    def cost(self, cells: np.ndarray) -> np.ndarray:
        """Return travel costs of cells: the length of the path [m], each step weighted by its costs.

        Args:
            cells: shape (..., 2), int, (row, column) inside the raster.

        Returns:
            Shape (...), float64; inf where no path leads.
        """
        travel = self.travel[cells[..., 0] + 1, cells[..., 1] + 1]
        metres = self.costmap.grid.resolution / (STRAIGHT * SCALE)
        return np.where(travel == UNREACHED, np.inf, travel * metres)

    def path(self, row: int, col: int) -> np.ndarray | None:
        """Return the path to a cell as points a cell apart; straight lines replace staircases where they cost no more.

        Args:
            row: row of the cell.
            col: column of the cell.

        Returns:
            Shape (n, 2), float64, cell centres and points between them, from start to goal [m]; None without a path.
        """
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
    """Return the traversable cell at or nearest to a point."""
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
    """Search from a start: everywhere (Dijkstra), or until one goal is reached (A*).

    Args:
        costmap: where to travel.
        start: position of the robot (x, y), map frame [m]. Where the map says it cannot be, the nearest cell within the
            robot's radius is taken.
        goal: (row, column); only the path to this cell is final then.
        allow_unknown: whether the robot may cross unknown cells, at the highest cost of free ones.
        cost_weight: see `COST_WEIGHT`.

    Returns:
        The field; None if the robot is walled in by the map.
    """
    weights = step_weights(cost_weight, allow_unknown)
    cell = _traversable_cell(costmap, weights, start, costmap.params.robot_radius, COST_INSCRIBED)
    if cell is None:
        return None
    return TravelField(costmap, weights, *search(costmap.costs, weights, *cell, *(goal or (-1, -1))))


def plan_path(
    costmap: Costmap,
    start: tuple[float, float],
    goal: tuple[float, float],
    *,
    tolerance: float = 0.0,
    allow_unknown: bool = False,
) -> np.ndarray | None:
    """Find the cheapest path to a goal with A*.

    Args:
        costmap: where to travel.
        start: position of the robot (x, y), map frame [m].
        goal: where to go (x, y), map frame [m].
        tolerance: how far beside the goal the path may end where the goal is not traversable [m].
        allow_unknown: whether the robot may cross unknown cells, at the highest cost of free ones.

    Returns:
        Shape (n, 2), float64, points a cell apart from start to goal [m]; None if there is no path.
    """
    cell = _traversable_cell(costmap, step_weights(COST_WEIGHT, allow_unknown), goal, tolerance, COST_MAX_FREE)
    if cell is None:
        return None
    field = travel_field(costmap, start, goal=cell, allow_unknown=allow_unknown)
    return None if field is None else field.path(*cell)
