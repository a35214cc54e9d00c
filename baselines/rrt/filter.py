"""The filter between the detectors and the assigner (seed 2, section 2.1.2): few points for the many found."""

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid
from envs.navigation import count_unknown

MAX_ITERATIONS = 300
"""Steps after which a mean counts as settled, as scikit-learn has it."""
SETTLED = 1e-3
"""Share of the bandwidth that a mean which has settled moves less than in a step, as scikit-learn has it."""


@njit(cache=True, error_model="numpy")
def _climb(points, bandwidth):
    """Move from each point to the mean of the points around it, until that stays.

    Args:
        points: shape (n, 2), float64, in the order of their x.
        bandwidth: radius of what counts as around.

    Returns:
        Where each climb ended, shape (n, 2), float64, and how many points lay around it, shape (n,), int64.
    """
    tops = points.copy()
    xs = points[:, 0].copy()
    # Only points in this strip can lie around; a hair wider than it need be, so that rounding leaves none out.
    strip = bandwidth * (1.0 + 1e-9)
    weights = np.zeros(len(points), dtype=np.int64)
    for k in range(len(points)):
        x, y = points[k]
        for _ in range(MAX_ITERATIONS):
            sum_x, sum_y, count = 0.0, 0.0, 0
            for j in range(np.searchsorted(xs, x - strip), np.searchsorted(xs, x + strip)):
                dx, dy = points[j, 0] - x, points[j, 1] - y
                inside = dx * dx + dy * dy <= bandwidth * bandwidth
                sum_x += points[j, 0] if inside else 0.0
                sum_y += points[j, 1] if inside else 0.0
                count += inside
            if count == 0:
                # Points exactly as far away as the bandwidth, by a rounding error.
                break
            moved = np.hypot(sum_x / count - x, sum_y / count - y)
            x, y = sum_x / count, sum_y / count
            weights[k] = count
            if moved <= SETTLED * bandwidth:
                break
        tops[k] = x, y
    return tops, weights


@njit(cache=True, error_model="numpy")
def _stands_alone(tops, bandwidth):
    """Tell which points (shape (n, 2)) lie beyond the bandwidth of all before them that do: shape (n,), bool."""
    alone = np.ones(len(tops), dtype=np.bool_)
    for k in range(len(tops)):
        if not alone[k]:
            continue
        for j in range(k + 1, len(tops)):
            dx, dy = tops[j, 0] - tops[k, 0], tops[j, 1] - tops[k, 1]
            alone[j] &= dx * dx + dy * dy > bandwidth * bandwidth
    return alone


@njit(cache=True, error_model="numpy")
def _count_around(data, cells, radius):
    """Count the unknown cells within `radius` cells of each of some cells (shape (n, 2)): shape (n,), int64."""
    counts = np.empty(len(cells), dtype=np.int64)
    for k in range(len(cells)):
        counts[k] = count_unknown(data, cells[k, 0], cells[k, 1], radius)
    return counts


def mean_shift(points: np.ndarray, bandwidth: float) -> np.ndarray:
    """Cluster points by mean shift with a flat kernel (Comaniciu and Meer 2002), equal to scikit-learn's centres.

    Args:
        points: shape (n, 2), float64 [m].
        bandwidth: radius of the kernel, and least distance between two centres [m].

    Returns:
        Shape (k, 2), float64 [m]: the centres, those with most points around them first.
    """
    tops, weights = _climb(points[np.argsort(points[:, 0], kind="stable")], bandwidth)
    tops = tops[np.lexsort((tops[:, 1], tops[:, 0], weights))[::-1]]
    return tops[_stands_alone(tops, bandwidth)]


def information_gain(grid: OccupancyGrid, points: np.ndarray, radius: float) -> np.ndarray:
    """Return the unknown area around points: unknown cells times the area of a cell (seed 2, figure 2.4).

    Args:
        grid: the map; what lies outside of it is unknown.
        points: shape (n, 2), map frame [m].
        radius: around each point [m].

    Returns:
        Shape (n,), float64 [m2].
    """
    areas: np.ndarray = _count_around(grid.data, grid.cells(points), radius / grid.resolution) * grid.resolution**2
    return areas
