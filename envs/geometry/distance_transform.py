"""Euclidean distance transforms of occupancy rasters."""

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit

MAX_REACH = 180
"""Maximum search distance [cells]. For greater distances, sums of squares overflow uint16."""


@njit(cache=True, error_model="numpy")
def squared_distances(occupied, reach):
    """Return the squared distance from each cell to the nearest occupied cell, uint16 [squared cells].

    After Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions" (2012). Values are exact up to
    `reach**2`, and greater in farther cells.

    Args:
        occupied: shape (height, width), bool.
        reach: search distance, 1 to 180 [cells].
    """
    height, width = occupied.shape
    far = np.uint16((reach + 1) * (reach + 1))
    along_row = np.empty((height, width), dtype=np.uint16)
    is_empty = np.empty(height, dtype=np.bool_)
    for row in range(height):
        line = along_row[row]
        steps = reach + 1
        nearest = steps
        for col in range(width):
            steps = 0 if occupied[row, col] else min(steps + 1, reach + 1)
            nearest = min(nearest, steps)
            line[col] = steps * steps
        is_empty[row] = nearest > reach
        steps = reach + 1
        for col in range(width - 1, -1, -1):
            steps = 0 if occupied[row, col] else min(steps + 1, reach + 1)
            line[col] = min(line[col], np.uint16(steps * steps))
    squared = np.full((height, width), far, dtype=np.uint16)
    for row in range(height):
        line = squared[row]
        for other in range(max(0, row - reach), min(height, row + reach + 1)):
            if is_empty[other]:
                continue
            offset = np.uint16((other - row) * (other - row))
            source = along_row[other]
            for col in range(width):
                line[col] = min(line[col], np.uint16(source[col] + offset))
    return squared


def deepest_cell(area: np.ndarray) -> tuple[int, int]:
    """Return the cell (row, column) of an area that is farthest from all cells outside the area.

    `area`: shape (height, width), bool, with a cell outside. Space beyond the array does not count as outside.
    """
    row, col = np.unravel_index(ndimage.distance_transform_edt(area).argmax(), area.shape)
    return int(row), int(col)
