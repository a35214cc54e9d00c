"""The filter between detectors and assigner (Nguyen et al. 2022, section 2.1.2): clusters points, measures their gain.

The mean shift is not scikit-learn's `MeanShift`, which the tests compare it with: that one searches neighbours for one
seed at a time, and takes 50 to 270 ms for the 100 to 430 points of a control step of 100 ms, 70 to 140 ms with
`bin_seeding=True`. Distances between all points in NumPy and SciPy take up to 10 ms, these kernels up to 0.3 ms.
"""

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid

MAX_ITERATIONS = 300
"""Steps after which a mean counts as converged, as in scikit-learn."""
TOLERANCE = 1e-3
"""Share of the bandwidth that a converged mean moves less than in a step, as in scikit-learn."""


@njit(cache=True, error_model="numpy")
def _converge(points, bandwidth):
    """Move from each point (shape (n, 2), float64, in the order of x) to the mean of those around it, until that stays.

    Returns the means, shape (n, 2), float64, and the number of points around each, shape (n,), int64.
    """
    means, counts = points.copy(), np.zeros(len(points), dtype=np.int64)
    xs = points[:, 0].copy()
    # Only points in this strip can lie around; slightly wider, so that rounding leaves none out.
    strip = bandwidth * (1.0 + 1e-9)
    for k in range(len(points)):
        x, y = points[k]
        for _ in range(MAX_ITERATIONS):
            sum_x, sum_y, count = 0.0, 0.0, 0
            for j in range(np.searchsorted(xs, x - strip), np.searchsorted(xs, x + strip)):
                inside = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 <= bandwidth * bandwidth
                sum_x += points[j, 0] if inside else 0.0
                sum_y += points[j, 1] if inside else 0.0
                count += inside
            if count == 0:
                break  # rounding: all points lay exactly as far away as the bandwidth
            moved = np.hypot(sum_x / count - x, sum_y / count - y)
            x, y, counts[k] = sum_x / count, sum_y / count, count
            if moved <= TOLERANCE * bandwidth:
                break
        means[k] = x, y
    return means, counts


@njit(cache=True, error_model="numpy")
def _suppress_near(means, bandwidth):
    """Return which means (shape (n, 2)) lie beyond the bandwidth of all before them that do: shape (n,), bool."""
    kept = np.ones(len(means), dtype=np.bool_)
    for k in range(len(means)):
        for j in range(k + 1, len(means) if kept[k] else 0):
            kept[j] &= (means[j, 0] - means[k, 0]) ** 2 + (means[j, 1] - means[k, 1]) ** 2 > bandwidth * bandwidth
    return kept


def mean_shift(points: np.ndarray, bandwidth: float) -> np.ndarray:
    """Cluster points by mean shift with a flat kernel (Comaniciu and Meer 2002).

    Args:
        points: shape (n, 2), float64 [m].
        bandwidth: radius of the kernel, and least distance between two centres [m].

    Returns:
        Shape (k, 2), float64 [m]: the centres, those with most points around them first.
    """
    means, counts = _converge(points[np.argsort(points[:, 0], kind="stable")], bandwidth)
    means = means[np.lexsort((means[:, 1], means[:, 0], counts))[::-1]]
    return means[_suppress_near(means, bandwidth)]


@njit(cache=True, error_model="numpy")
def _count_unknown(data, cells, others, radius):
    """Count the unknown cells within `radius` cells of both cells of a pair; outside of the array all are unknown.

    `cells` and `others` have the shape (n, 2), int64, (row, column); what is returned has the shape (n,), int64.
    """
    height, width = data.shape
    counts = np.zeros(len(cells), dtype=np.int64)
    reach = int(radius)
    for k in range(len(cells)):
        row0, col0 = cells[k]
        row1, col1 = others[k]
        for row in range(max(row0, row1) - reach, min(row0, row1) + reach + 1):
            half0 = int(np.sqrt(radius * radius - (row - row0) ** 2))
            half1 = int(np.sqrt(radius * radius - (row - row1) ** 2))
            for col in range(max(col0 - half0, col1 - half1), min(col0 + half0, col1 + half1) + 1):
                counts[k] += row < 0 or row >= height or col < 0 or col >= width or data[row, col] < 0
    return counts


def information_gain(
    grid: OccupancyGrid, points: np.ndarray, radius: float, shared_with: np.ndarray | None = None
) -> np.ndarray:
    """Return the unknown area around points: unknown cells times the area of a cell (Nguyen et al. 2022, figure 2.4).

    Args:
        grid: the map; what lies outside of it is unknown.
        points: shape (n, 2), map frame [m].
        radius: around each point [m].
        shared_with: shape (2,), map frame [m]: count only what lies within the radius of this point as well.

    Returns:
        Shape (n,), float64 [m2].
    """
    cells = grid.cells(points)
    others = cells if shared_with is None else np.broadcast_to(grid.cells(shared_with), cells.shape)
    areas: np.ndarray = _count_unknown(grid.data, cells, others, radius / grid.resolution) * grid.resolution**2
    return areas
