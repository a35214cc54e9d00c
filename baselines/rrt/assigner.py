"""Who goes where (seed 2, section 2.1.3): points shared out among robots by revenue."""

import math

import numpy as np
from numba import njit

from baselines.rrt.filter import information_gain
from envs.geometry import OccupancyGrid

NOBODY = -1
"""In place of a point, for a robot that gets none."""
NONE_TAKEN = np.empty((0, 2))
"""No other robot is on its way to a point."""


@njit(cache=True, error_model="numpy")
def _count_shared(data, row0, col0, row1, col1, radius):
    """Count the unknown cells that lie in both of two discs; what lies outside the array is unknown."""
    height, width = data.shape
    count = 0
    reach = int(radius)
    for d_row in range(-reach, reach + 1):
        half = int(np.sqrt(radius * radius - d_row * d_row))
        r = row0 + d_row
        rest = radius * radius - (r - row1) ** 2
        if rest < 0:
            continue
        other = int(np.sqrt(rest))
        for c in range(max(col0 - half, col1 - other), min(col0 + half, col1 + other) + 1):
            count += r < 0 or r >= height or c < 0 or c >= width or data[r, c] < 0
    return count


@njit(cache=True, error_model="numpy")
def _shared_counts(data, cells, taken, radius):
    """Count the unknown cells within `radius` cells both of each cell (shape (n, 2)) and of one: shape (n,), int64."""
    counts = np.empty(len(cells), dtype=np.int64)
    for k in range(len(cells)):
        counts[k] = _count_shared(data, taken[0], taken[1], cells[k, 0], cells[k, 1], radius)
    return counts


def assign(
    grid: OccupancyGrid,
    robots: np.ndarray,
    points: np.ndarray,
    costs: np.ndarray,
    *,
    info_radius: float,
    info_multiplier: float,
    hysteresis_radius: float,
    hysteresis_gain: float,
    taken: np.ndarray = NONE_TAKEN,
) -> np.ndarray:
    """Share points out: again and again the robot and the point of the greatest revenue, until either is used up.

    The revenue is R = lambda h(x_fp, x_r) I(x_fp) - N(x_fp). What a robot will see at its point is no gain for the
    others any more: unknown cells within the information radius of both points no longer count.

    Args:
        grid: the map that the robots share.
        robots: shape (n, 2), float64, positions x_r, map frame [m].
        points: shape (m, 2), float64, frontier points x_fp, map frame [m].
        costs: shape (n, m), float64, navigation costs N [m]; inf where a robot cannot get to a point.
        info_radius: radius in which unknown area counts as gain I [m].
        info_multiplier: lambda, what a gain is worth in way [1/m].
        hysteresis_radius: distance up to which h = `hysteresis_gain`, and beyond which h = 1 [m].
        hysteresis_gain: greater than 1, so that a robot finishes what is around it first.
        taken: shape (k, 2), float64, points that other robots are on their way to already, map frame [m].

    Returns:
        Shape (n,), int64: index of each robot's point; `NOBODY` where there is none left that it can get to.

    Raises:
        ValueError: `costs` does not have a row for each robot and a column for each point.
    """
    if costs.shape != (len(robots), len(points)):
        raise ValueError(f"costs must have the shape {(len(robots), len(points))} (robots, points), got {costs.shape}")
    chosen = np.full(len(robots), NOBODY, dtype=np.int64)
    gains = information_gain(grid, points, info_radius)
    for point in taken:
        gains = gains - _shared_gain(grid, points, point, info_radius)
    gaps = robots[:, None] - points[None]
    is_near = np.hypot(gaps[..., 0], gaps[..., 1]) <= hysteresis_radius
    factors = info_multiplier * np.where(is_near, hysteresis_gain, 1.0)
    open_costs = costs.astype(np.float64)
    for _ in range(min(len(robots), len(points))):
        revenues = factors * gains - open_costs
        robot, point = np.unravel_index(np.argmax(revenues), revenues.shape)
        if math.isinf(revenues[robot, point]):
            break
        chosen[robot] = point
        gains = gains - _shared_gain(grid, points, points[point], info_radius)
        open_costs[robot] = open_costs[:, point] = np.inf
    return chosen


def _shared_gain(grid: OccupancyGrid, points: np.ndarray, taken: np.ndarray, radius: float) -> np.ndarray:
    """Return the unknown area within `radius` [m] both of each point and of the one taken: shape (n,), float64 [m2]."""
    counts = _shared_counts(grid.data, grid.cells(points), grid.cells(taken), radius / grid.resolution)
    areas: np.ndarray = counts * grid.resolution**2
    return areas
