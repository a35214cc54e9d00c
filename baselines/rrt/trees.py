"""Rapidly-exploring random trees that find frontiers.

Nguyen et al. (2022), algorithm 2.1; Umari and Mukhopadhyay (2017).
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.lines import next_cell, start_walk
from lidarnaut.envs.navigation.maps.costmap import OCCUPIED_FROM

SPACING = 0.3
"""Minimum distance of a new vertex from the nearest vertex of a tree [m]."""
UNKNOWN_AHEAD, BLOCKED, CLEAR = -1, 0, 1
"""Results of checking cells along a line: unknown first, obstacle first, or all free."""


@njit(cache=True, error_model="numpy")
def nearest(vertices, count, x, y):
    """Return the index of the tree vertex nearest to the point (x, y).

    `vertices`: coordinates, shape (2, capacity), float32 [cells]. Only the first `count` > 0 columns are used.
    """
    xs, ys = vertices[0, :count], vertices[1, :count]
    best, index = np.float32(np.inf), 0
    # The compiler vectorizes the minimum of 16 values, but not the search for its index.
    for first in range(0, count, 16):
        last = min(first + 16, count)
        least = np.float32(np.inf)
        for k in range(first, last):
            dx, dy = xs[k] - np.float32(x), ys[k] - np.float32(y)
            least = min(least, dx * dx + dy * dy)
        if least < best:
            best = least
            for k in range(first, last):
                dx, dy = xs[k] - np.float32(x), ys[k] - np.float32(y)
                if dx * dx + dy * dy <= least:
                    index = k
                    break
    return index


@njit(cache=True, error_model="numpy")
def steer(x0, y0, x, y, eta):
    """Return the point nearest to (x, y) within a distance `eta` of (x0, y0), all in cells."""
    length = math.hypot(x - x0, y - y0)
    if length <= eta:
        return x, y
    return x0 + (x - x0) * eta / length, y0 + (y - y0) * eta / length


@njit(cache=True, error_model="numpy")
def grid_check(data, u0, v0, u1, v1):
    """Find the first unknown or occupied cell on a line, except for the cell at the start.

    `data`: occupancy [percent], -1 if unknown, shape (height, width), int8. `u0`, `v0`, `u1`, `v1`: start and end
    (column, row) [cells]. Cells outside the map are unknown.

    Returns:
        `UNKNOWN_AHEAD`, `BLOCKED` or `CLEAR`; center of the found cell or end of the line (column, row).
    """
    height, width = data.shape
    # A new obstacle at the start must not block all steps from this vertex.
    walk = start_walk(u0, v0, u1, v1)
    while walk.rows_left + walk.cols_left > 0:
        walk = next_cell(walk)
        row, col = walk.row, walk.col
        if row < 0 or row >= height or col < 0 or col >= width or data[row, col] < 0:
            return UNKNOWN_AHEAD, col + 0.5, row + 0.5
        if data[row, col] >= OCCUPIED_FROM:
            return BLOCKED, col + 0.5, row + 0.5
    return CLEAR, u1, v1


@njit(cache=True, error_model="numpy")
def grow(data, samples, eta, spacing, resets, robot, vertices, count, found):
    """Grow a random tree towards each sample in turn, and find frontier points (Nguyen et al. 2022, algorithm 2.1).

    Lengths and positions are in cells. `eta`: maximum step length. `spacing`: minimum distance of a new vertex from the
    tree. `resets`: whether the tree restarts at `robot` after each frontier point. `vertices`: positions of `count`
    vertices, extended in place, shape (2, capacity). `found`: output for frontier points.

    Returns:
        Number of vertices, and number of frontier points.
    """
    num_found = 0
    for k in range(len(samples)):
        near = nearest(vertices, count, samples[k, 0], samples[k, 1])
        u0, v0 = float(vertices[0, near]), float(vertices[1, near])
        u, v = steer(u0, v0, samples[k, 0], samples[k, 1], eta)
        verdict, end_u, end_v = grid_check(data, u0, v0, u, v)
        if verdict == UNKNOWN_AHEAD:
            found[num_found] = end_u, end_v
            num_found += 1
            if resets:
                vertices[0, 0], vertices[1, 0] = robot
                count = 1
        elif verdict == CLEAR and math.hypot(u - u0, v - v0) >= spacing:
            vertices[0, count], vertices[1, count] = u, v
            count += 1
    return count, num_found


class Tree:
    """Random tree that grows through free space. Steps into unknown space yield frontier points."""

    def __init__(self, root: tuple[float, float], *, eta: float, resets: bool) -> None:
        self._eta, self._resets = eta, resets
        self.vertices = np.array([root], dtype=np.float64)
        """Positions of the tree's vertices, root first, shape (n, 2), float64, map frame [m]."""

    @property
    def edges(self) -> np.ndarray:
        """Edges from parent to child, shape (n - 1, 2, 2), float64, map frame [m]."""
        # The vertex nearest to a sample is also nearest to all points on the way to the sample (triangle inequality).
        columns = self.vertices.T.astype(np.float32)
        parents = [nearest(columns, k, *self.vertices[k]) for k in range(1, len(self.vertices))]
        return np.stack([self.vertices[parents], self.vertices[1:]], axis=1)

    def grow(self, grid: OccupancyGrid, samples: np.ndarray, robot: tuple[float, float]) -> np.ndarray:
        """Grow the tree towards samples, and return the frontier points found.

        `samples`, result: positions, shape (n, 2), float64, map frame [m]. `robot`: position (x, y), map frame [m].
        """
        count, scale, origin = len(self.vertices), grid.resolution, np.array(grid.origin)
        vertices = np.empty((2, count + len(samples)), dtype=np.float32)
        vertices[:, :count] = ((self.vertices - origin) / scale).T
        u, v = ((np.array(robot) - origin) / scale).tolist()
        lengths, found = (self._eta / scale, SPACING / scale), np.empty((len(samples), 2))
        cells = (samples - origin) / scale
        count, num_found = grow(grid.data, cells, *lengths, self._resets, (u, v), vertices, count, found)
        self.vertices = vertices[:, :count].T * np.float64(scale) + origin
        return found[:num_found] * scale + origin
