"""Euclidean distance transforms of occupancy rasters."""

import numpy as np

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


@njit(cache=True, error_model="numpy")
def deepest_cell(area):
    """Return the cell (row, column) of an area that is farthest from all cells outside the area.

    `area`: shape (height, width), bool. Space beyond the array does not count as outside. Distance transform of
    Meijster, Roerdink and Hesselink (2000).
    """
    height, width = area.shape
    # Distance to the nearest cell outside in the same column, or `nowhere`.
    nowhere = height + width
    down = np.empty((height, width), dtype=np.int32)
    for row in range(height):
        above = down[max(row - 1, 0)]
        for col in range(width):
            longer = min(above[col] + 1, nowhere) if row > 0 else nowhere
            down[row, col] = longer if area[row, col] else 0
    for row in range(height - 2, -1, -1):
        for col in range(width):
            down[row, col] = min(down[row, col], down[row + 1, col] + 1)
    # Lower envelope of parabolas along a row: columns, and where each begins.
    lowest, begins = np.empty(width, dtype=np.int64), np.empty(width, dtype=np.int64)
    greatest, at_row, at_col = -1, 0, 0
    for row in range(height):
        depths, last = down[row], -1
        for col in range(width):
            depth, begin = depths[col], 0
            while last >= 0:
                other, first = lowest[last], begins[last]
                if (first - other) ** 2 + depths[other] ** 2 <= (first - col) ** 2 + depth**2:
                    begin = (col**2 - other**2 + depth**2 - depths[other] ** 2) // (2 * (col - other)) + 1
                    break
                last -= 1
            if begin < width:
                last += 1
                lowest[last], begins[last] = col, begin
        for col in range(width - 1, -1, -1):
            squared = (col - lowest[last]) ** 2 + depths[lowest[last]] ** 2
            if squared > greatest or (squared == greatest and row == at_row):
                greatest, at_row, at_col = squared, row, col
            if col == begins[last]:
                last -= 1
    return at_row, at_col
