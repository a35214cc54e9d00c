"""Contour lines of a field on a grid, as closed loops of few segments."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def _link(links, a, b):
    """Note that the contour runs from grid edge `a` to grid edge `b`."""
    links[a, 0 if links[a, 0] < 0 else 1] = b
    links[b, 0 if links[b, 0] < 0 else 1] = a


@njit(cache=True, error_model="numpy")
def _march(field, level, links, points):
    """Find where the contour crosses each grid edge, and which crossings follow each other (marching squares).

    Grid edge 2 k runs from point k to its right neighbour, 2 k + 1 from point k to the one above.
    """
    height, width = field.shape
    for row in range(height):
        for col in range(width):
            k = row * width + col
            here = field[row, col]
            if col + 1 < width and (here < level) != (field[row, col + 1] < level):
                points[2 * k, 0] = col + (level - here) / (field[row, col + 1] - here)
                points[2 * k, 1] = row
            if row + 1 < height and (here < level) != (field[row + 1, col] < level):
                points[2 * k + 1, 0] = col
                points[2 * k + 1, 1] = row + (level - here) / (field[row + 1, col] - here)
    for row in range(height - 1):
        for col in range(width - 1):
            k = row * width + col
            south, north, west, east = 2 * k, 2 * (k + width), 2 * k + 1, 2 * (k + 1) + 1
            a, b = field[row, col] < level, field[row, col + 1] < level
            c, d = field[row + 1, col] < level, field[row + 1, col + 1] < level
            if a != b and c != d and a != c:
                # A saddle: low corners stay apart.
                _link(links, south, west if a else east)
                _link(links, north, east if a else west)
            else:
                first = -1
                for edge, crossed in ((south, a != b), (north, c != d), (west, a != c), (east, b != d)):
                    if crossed:
                        if first < 0:
                            first = edge
                        else:
                            _link(links, first, edge)


@njit(cache=True, error_model="numpy")
def _trace(links, points, tolerance, segments):
    """Walk around every loop and write as few segments as stay within `tolerance` of it; return how many."""
    count = 0
    loop = np.empty(links.shape[0], dtype=np.int64)
    for start in range(links.shape[0]):
        if links[start, 0] < 0:
            continue
        n, edge = 0, start
        while links[edge, 0] >= 0:
            loop[n] = edge
            n += 1
            ahead = links[edge, 0] if n == 1 or links[edge, 0] != loop[n - 2] else links[edge, 1]
            links[edge, 0] = -1
            edge = ahead
        i = 0
        while i < n:
            j = i + 1
            while j < n and _is_straight(points, loop, i, j + 1, n, tolerance):
                j += 1
            here, there = loop[i], loop[j % n]
            segments[count, 0], segments[count, 1] = points[here, 0], points[here, 1]
            segments[count, 2], segments[count, 3] = points[there, 0], points[there, 1]
            count += 1
            i = j
    return count


@njit(cache=True, error_model="numpy")
def _is_straight(points, loop, i, j, n, tolerance):
    """Tell whether the loop's points between the i-th and the j-th lie within `tolerance` of the line between those."""
    x, y = points[loop[i], 0], points[loop[i], 1]
    dx, dy = points[loop[j % n], 0] - x, points[loop[j % n], 1] - y
    length = np.hypot(dx, dy)
    if length == 0.0:
        return False
    for k in range(i + 1, j):
        px, py = points[loop[k], 0], points[loop[k], 1]
        if abs((px - x) * dy - (py - y) * dx) > tolerance * length:
            return False
    return True


def contour(field: np.ndarray, level: float, tolerance: float) -> np.ndarray:
    """Return the closed lines on which a field takes a value, within a tolerance.

    Args:
        field: shape (height, width), float64; all of its edge on one side of `level`.
        level: the value.
        tolerance: how far a segment may be from the line that it replaces [grid steps].

    Returns:
        Shape (n, 4), float64, (column, row, column, row) [grid steps].
    """
    links = np.full((2 * field.size, 2), -1, dtype=np.int64)
    points = np.zeros((2 * field.size, 2))
    _march(field, level, links, points)
    segments = np.empty((np.count_nonzero(links[:, 0] >= 0), 4))
    count = _trace(links, points, tolerance, segments)
    return segments[:count]
