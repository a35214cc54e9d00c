"""Frontiers: where what is known to be free borders on what is unknown (Yamauchi 1997; seed 3, section 3.2)."""

from itertools import pairwise

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid

FREE_BELOW = 50
"""Occupancy from which a cell no longer counts as free [percent]."""


@njit(cache=True, error_model="numpy")
def mark_frontier(data):
    """Mark free cells (0..49) with an unknown cell (-1) among their eight neighbours.

    Works on whole rows, so that the compiler vectorises it: the least value in the three rows around a cell, then the
    least of three neighbouring columns, is negative exactly where one of the nine cells is unknown.
    """
    height, width = data.shape
    mask = np.zeros((height, width), dtype=np.bool_)
    lowest = np.empty(width, dtype=np.int8)
    for row in range(height):
        above, middle, below = data[max(row - 1, 0)], data[row], data[min(row + 1, height - 1)]
        for col in range(width):
            lowest[col] = min(above[col], middle[col], below[col])
        for col in range(1, width - 1):
            near = min(lowest[col - 1], lowest[col], lowest[col + 1])
            mask[row, col] = (middle[col] >= 0) & (middle[col] < FREE_BELOW) & (near < 0)
        for col in (0, width - 1):
            near = min(lowest[max(col - 1, 0)], lowest[col], lowest[min(col + 1, width - 1)])
            mask[row, col] = (middle[col] >= 0) & (middle[col] < FREE_BELOW) & (near < 0)
    return mask


def frontier_mask(grid: OccupancyGrid) -> np.ndarray:
    """Mark the frontier cells of a map: free ones with an unknown one among their eight neighbours.

    Returns:
        Shape of the map, bool.
    """
    return mark_frontier(grid.data)


@njit(cache=True, error_model="numpy")
def flood(mask, cells):
    """Group marked cells that touch, also diagonally.

    Args:
        mask: shape (height, width), bool; cleared on the way.
        cells: shape (n, 2), int64, written: the cells, group after group.

    Returns:
        Where each group begins in `cells`, followed by n.
    """
    height, width = mask.shape
    starts = [0]
    count = 0
    for row in range(height):
        for col in range(width):
            if not mask[row, col]:
                continue
            mask[row, col] = False
            cells[count] = row, col
            head, count = count, count + 1
            while head < count:
                r0, c0 = cells[head]
                head += 1
                for r in range(max(r0 - 1, 0), min(r0 + 2, height)):
                    for c in range(max(c0 - 1, 0), min(c0 + 2, width)):
                        if mask[r, c]:
                            mask[r, c] = False
                            cells[count] = r, c
                            count += 1
            starts.append(count)
    return starts


def frontier_clusters(mask: np.ndarray) -> list[np.ndarray]:
    """Split frontier cells into groups of cells that touch, also diagonally.

    Args:
        mask: shape (height, width), bool.

    Returns:
        For each group its cells (row, column), shape (k, 2), int64, in the order of their lowest cells.
    """
    cells = np.empty((np.count_nonzero(mask), 2), dtype=np.int64)
    starts = flood(mask.copy(), cells)
    return [cells[a:b] for a, b in pairwise(starts)]


@njit(cache=True, error_model="numpy")
def count_unknown(data, row, col, radius):
    """Count the unknown cells (-1) within a disc; what lies outside the array has not been observed either.

    Args:
        data: shape (height, width), int8, occupancy.
        row: row of the centre.
        col: column of the centre.
        radius: radius of the disc [cells].
    """
    height, width = data.shape
    count = 0
    reach = int(radius)
    for d_row in range(-reach, reach + 1):
        r = row + d_row
        half = int(np.sqrt(radius * radius - d_row * d_row))
        if r < 0 or r >= height:
            count += 2 * half + 1
            continue
        for c in range(col - half, col + half + 1):
            count += c < 0 or c >= width or data[r, c] < 0
    return count


@njit(cache=True, error_model="numpy")
def _next_marked(following, row, col):
    """Return the first column from `col` on that still awaits a label in a row, shortening the way there."""
    end = col
    while following[row, end] != end:
        end = following[row, end]
    while following[row, col] != end:
        following[row, col], col = end, following[row, col]
    return end


@njit(cache=True, error_model="numpy")
def _cores(mask, halves, min_samples):
    """Mark the marked cells with at least `min_samples` marked ones around them, itself included, by sums over rows."""
    height, width = mask.shape
    reach = len(halves) // 2
    sums = np.zeros((height, width + 1), dtype=np.int32)
    for row in range(height):
        for col in range(width):
            sums[row, col + 1] = sums[row, col] + mask[row, col]
    is_core = np.zeros((height, width), dtype=np.bool_)
    for row in range(height):
        for col in range(width):
            if not mask[row, col]:
                continue
            count = 0
            for r in range(max(row - reach, 0), min(row + reach + 1, height)):
                half = halves[r - row + reach]
                count += sums[r, min(col + half + 1, width)] - sums[r, max(col - half, 0)]
            is_core[row, col] = count >= min_samples
    return is_core


@njit(cache=True, error_model="numpy")
def dbscan(mask, eps, min_samples):
    """Cluster marked cells by density (Ester, Kriegel, Sander, Xu 1996).

    Gives exactly scikit-learn's labels for the cells in row-major order, border points included, but thirty times as
    fast on the tens of thousands of frontier cells that lie between the beams of a long-range lidar: chains of what
    awaits a label lead past the rest of a row.

    Args:
        mask: shape (height, width), bool.
        eps: distance up to which cells are neighbours [cells].
        min_samples: neighbours, itself included, that make a cell the core of a cluster.

    Returns:
        Labels from 0, shape of the mask, int32, -1 for noise and for what is not marked; and the number of clusters.
    """
    height, width = mask.shape
    reach = int(eps)
    halves = np.array([int(np.sqrt(eps * eps - d_row * d_row)) for d_row in range(-reach, reach + 1)])
    is_core = _cores(mask, halves, min_samples)
    following = np.full((height, width + 1), width, dtype=np.int32)
    for row in range(height):
        for col in range(width - 1, -1, -1):
            following[row, col] = col if mask[row, col] else following[row, col + 1]
    labels = np.full((height, width), -1, dtype=np.int32)
    stack = np.empty((np.count_nonzero(mask), 2), dtype=np.int32)
    num_clusters = 0
    for row in range(height):
        for col in range(width):
            if not is_core[row, col] or labels[row, col] >= 0:
                continue
            labels[row, col] = num_clusters
            following[row, col] = col + 1
            stack[0] = row, col
            size = 1
            while size > 0:
                size -= 1
                r0, c0 = stack[size]
                for r in range(max(r0 - reach, 0), min(r0 + reach + 1, height)):
                    half = halves[r - r0 + reach]
                    c = _next_marked(following, r, max(c0 - half, 0))
                    while c <= min(c0 + half, width - 1):
                        labels[r, c] = num_clusters
                        following[r, c] = c + 1
                        if is_core[r, c]:
                            stack[size] = r, c
                            size += 1
                        c = _next_marked(following, r, c + 1)
            num_clusters += 1
    return labels, num_clusters


@njit(cache=True, error_model="numpy")
def clear_around(mask, cells):
    """Clear marked cells and their eight neighbours.

    Args:
        mask: shape (height, width), bool, changed.
        cells: shape (n, 2), int64, (row, column), also outside the mask.

    Returns:
        Shape (n,), bool: around which of the cells there was anything to clear.
    """
    useful = np.zeros(len(cells), dtype=np.bool_)
    for k in range(len(cells)):
        row, col = cells[k]
        around = mask[max(row - 1, 0) : max(row + 2, 0), max(col - 1, 0) : max(col + 2, 0)]
        useful[k] = around.any()
    for k in range(len(cells)):
        row, col = cells[k]
        mask[max(row - 1, 0) : max(row + 2, 0), max(col - 1, 0) : max(col + 2, 0)] = False
    return useful
