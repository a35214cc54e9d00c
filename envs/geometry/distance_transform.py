"""Distances from the nearest obstacle on a raster."""

import numpy as np
from numba import njit

MAX_REACH = 180
"""Greatest reach whose squares fit their type [cells]."""


@njit(cache=True, error_model="numpy")
def squared_distances(occupied, reach):
    """Measure how far each cell lies from the nearest occupied one, exactly up to a reach [cells], 1 to `MAX_REACH`.

    Separable as in Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions" (2012): first along rows,
    then down columns. With a small reach the second pass is a plain minimum over offsets, which the compiler
    vectorises. `occupied`: shape (height, width), bool.

    Returns:
        Shape (height, width), uint16: squared distance between cell centres [cells2] where that is at most `reach**2`,
        something greater everywhere else.
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
