"""Rapidly-exploring random trees that find frontiers.

Nguyen et al. (2022), section 2.1.1, algorithm 2.1; Umari and Mukhopadhyay, "Autonomous Robotic Exploration Based on
Multiple Rapidly-exploring Randomized Trees" (2017).

Three things the report leaves open:

- *Where the frontier point lies.* A step may be 15 m long; the point is where it first enters unknown space.
- *The cell a step starts from is not checked.* It was free when the vertex was added, or it is the robot's. Otherwise
  a vertex that the map has since covered with an obstacle would reject every sample around it.
- *Vertices keep a distance.* Without one a tree that is never reset gains a vertex with every sample, and Nearest
  becomes ever slower, though a vertex beside another one finds nothing that the other does not.
"""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.lines import next_cell, start_walk
from lidarnaut.envs.navigation.costmap import OCCUPIED_FROM

UNKNOWN_AHEAD, BLOCKED, CLEAR = -1, 0, 1
"""GridCheck: the step enters unknown space before it meets an obstacle, an obstacle comes first, all cells are free."""


@njit(cache=True, error_model="numpy")
def nearest(vertices, count, x, y):
    """Return the index of the vertex nearest to (x, y) among the first `count` > 0; the first of equals.

    `vertices` has the shape (2, capacity), float32.
    """
    xs, ys = vertices[0, :count], vertices[1, :count]
    best, index = np.float32(np.inf), 0
    # The least of sixteen at once: that the compiler turns into vector instructions, the search for where it was not.
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
    """Return the point nearest to (x, y) that is at most `eta` [m] away from (x0, y0)."""
    length = math.hypot(x - x0, y - y0)
    if length <= eta:
        return x, y
    return x0 + (x - x0) * eta / length, y0 + (y - y0) * eta / length


@njit(cache=True, error_model="numpy")
def grid_check(data, u0, v0, u1, v1):
    """Return what comes first in the cells that a line crosses, but for its first cell, and where the walk ended.

    The line leads from (u0, v0) to (u1, v1), column and row as real numbers: cell c holds [c, c + 1). What lies outside
    of `data`, shape (height, width), int8, occupancy, is unknown. The walk ends in the middle of the unknown or
    occupied cell, or at the end of the line.
    """
    height, width = data.shape
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
    """Grow a tree by samples, shape (n, 2), (column, row), one after the other (algorithm 2.1). Lengths are in cells.

    A tree that `resets` starts again at the robot (column, row) after each find. The first `count` of `vertices`, shape
    (2, capacity), float32, are there already; new ones are written behind them, and frontier points (column, row) to
    `found`, shape (n, 2), float64. Returns how many there are of both.
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
    """A detector: a tree that grows through free space and returns the points where it would enter unknown space."""

    def __init__(self, root: tuple[float, float], *, eta: float, spacing: float, resets: bool) -> None:
        """Start with the root alone, at (x, y), map frame [m].

        A step is at most `eta` long, a new vertex at least `spacing` away from the nearest one [m]. The local detector
        resets after each find, the global one does not.
        """
        self._eta, self._spacing, self._resets = eta, spacing, resets
        self.vertices = np.array([root], dtype=np.float64)
        """Shape (n, 2), float64, map frame [m]; the root is the first."""

    def grow(self, grid: OccupancyGrid, samples: np.ndarray, robot: tuple[float, float]) -> np.ndarray:
        """Grow by samples, shape (n, 2), float64, map frame [m]; a tree that resets starts again at the robot (x, y).

        Returns the frontier points found, shape (k, 2), float64, map frame [m], in the order of the samples.
        """
        count, scale, origin = len(self.vertices), grid.resolution, np.array(grid.origin)
        vertices = np.empty((2, count + len(samples)), dtype=np.float32)
        vertices[:, :count] = ((self.vertices - origin) / scale).T
        u, v = ((np.array(robot) - origin) / scale).tolist()
        lengths, found = (self._eta / scale, self._spacing / scale), np.empty((len(samples), 2))
        cells = (samples - origin) / scale
        count, num_found = grow(grid.data, cells, *lengths, self._resets, (u, v), vertices, count, found)
        self.vertices = vertices[:, :count].T * np.float64(scale) + origin
        return found[:num_found] * scale + origin
