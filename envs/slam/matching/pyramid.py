"""Maxima of a field over squares of growing size: upper bounds for scores of many poses at once.

Hess et al., Real-time loop closure in 2D lidar SLAM, 2016, section V.B.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

FULL = 100
"""Field value that scores 1 [percent]."""


class Pyramid(NamedTuple):
    """Maxima of a field over squares of growing size."""

    levels: np.ndarray
    """Shape (num_levels, height, width), uint8: cell (i, j) of level l is the greatest of the cells from (i, j) to
    (i + 2^l - 1, j + 2^l - 1) of level 0, which is the field within a border of zeros."""
    x: float
    """Position of the corner of cell (0, 0), with `y`, submap frame [m]."""
    y: float
    resolution: float
    """Side of a cell [m]."""
    reach: int
    """Largest half width of a window that may be searched [cells]."""


@njit(cache=True, error_model="numpy")
def _write_greatest(a, b, c, d, out):
    """Write the greatest of four arrays; all of shape (n,), uint8."""
    for j in range(out.shape[0]):
        left = a[j] if a[j] > b[j] else b[j]
        right = c[j] if c[j] > d[j] else d[j]
        out[j] = left if left > right else right


@njit(cache=True, error_model="numpy")
def build_pyramid(field, geometry, num_levels, reach, threshold):
    """Return the `Pyramid` of a field.

    Args:
        field: shape (height, width), uint8 [percent].
        geometry: `FieldGeometry`.
        num_levels: number of levels; the last one holds maxima over 2^(num_levels - 1) cells.
        reach: largest half width of a window that will be searched [m].
        threshold: cells up to this value count as 0: those that are free or unknown [percent].
    """
    side = 1 << (num_levels - 1)
    cells = math.ceil(reach / geometry.resolution)
    # A point that lies outside by the window's reach may get in. Moved away by as much, it leaves a row for the border
    # of the next one, which is as empty; above and below there must be twice the room.
    rows, cols = 2 * cells + side, cells + side
    height, width = field.shape[0] + 2 * rows, field.shape[1] + 2 * cols
    levels = np.zeros((num_levels, height, width), dtype=np.uint8)
    for i in range(field.shape[0]):
        source, target = field[i], levels[0, i + rows, cols : cols + field.shape[1]]
        for j in range(field.shape[1]):
            target[j] = source[j] if source[j] > threshold else np.uint8(0)
    for level in range(1, num_levels):
        half = 1 << (level - 1)
        finer, coarser = levels[level - 1].ravel(), levels[level].ravel()
        for i in range(rows + 1 - 2 * half, rows + field.shape[0]):
            first, last = i * width + cols + 1 - 2 * half, i * width + cols + field.shape[1]
            next_first, next_last = first + half * width, last + half * width
            _write_greatest(
                finer[first:last],
                finer[first + half : last + half],
                finer[next_first:next_last],
                finer[next_first + half : next_last + half],
                coarser[first:last],
            )
    x, y = geometry.x - cols * geometry.resolution, geometry.y - rows * geometry.resolution
    return Pyramid(levels, x, y, geometry.resolution, cells)
