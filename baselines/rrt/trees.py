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
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid
from envs.geometry.lines import next_cell, start_walk
from envs.navigation.costmap import OCCUPIED_FROM

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
    """Tell what comes first in the cells that a line crosses, but for its first cell.

    The line leads from (u0, v0) to (u1, v1), column and row as real numbers: cell c holds [c, c + 1). What lies outside
    of `data`, shape (height, width), int8, occupancy, is unknown.

    Returns:
        The verdict; and where the walk ended: middle of the unknown or occupied cell, or end of the line (column, row).
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


class GrowthRules(NamedTuple):
    """How a tree grows; lengths in metres, in cells for the kernel."""

    eta: float
    """Longest step."""
    spacing: float
    """Least distance of a new vertex from the nearest one."""
    resets: bool
    """Whether the tree starts again at the robot after each find."""


@njit(cache=True, error_model="numpy")
def grow(data, samples, rules, robot, vertices, parents, count, found):
    """Grow a tree by samples, one after the other (algorithm 2.1). All lengths are in cells.

    Args:
        data: shape (height, width), int8, occupancy.
        samples: shape (n, 2), float64, (column, row).
        rules: `GrowthRules`.
        robot: (column, row) where a tree that resets starts again.
        vertices: shape (2, capacity), float32, columns and rows, written.
        parents: shape (capacity,), int32, written: index of each vertex's parent; the root is its own.
        count: number of vertices.
        found: shape (n, 2), float64, written: frontier points (column, row).

    Returns:
        Number of vertices, and of frontier points found.
    """
    num_found = 0
    for k in range(len(samples)):
        near = nearest(vertices, count, samples[k, 0], samples[k, 1])
        u0, v0 = float(vertices[0, near]), float(vertices[1, near])
        u, v = steer(u0, v0, samples[k, 0], samples[k, 1], rules.eta)
        verdict, end_u, end_v = grid_check(data, u0, v0, u, v)
        if verdict == UNKNOWN_AHEAD:
            found[num_found] = end_u, end_v
            num_found += 1
            if rules.resets:
                vertices[0, 0], vertices[1, 0] = robot
                parents[0] = 0
                count = 1
        elif verdict == CLEAR and math.hypot(u - u0, v - v0) >= rules.spacing:
            vertices[0, count], vertices[1, count] = u, v
            parents[count] = near
            count += 1
    return count, num_found


class Tree:
    """A detector: a tree that grows through free space and returns the points where it would enter unknown space."""

    def __init__(self, root: tuple[float, float], *, eta: float, spacing: float, resets: bool) -> None:
        """Start with the root alone, at (x, y), map frame [m]; the rules are those of `GrowthRules`.

        The local detector resets, the global one does not.
        """
        self._rules = GrowthRules(eta, spacing, resets)
        self._points = np.array([[root[0]], [root[1]]], dtype=np.float64)
        self.parents = np.zeros(1, dtype=np.int32)
        """Shape (n,), int32: index of each vertex's parent; the root is its own."""

    @property
    def vertices(self) -> np.ndarray:
        """Shape (n, 2), float64, map frame [m]; the root is the first."""
        return self._points.T

    def grow(self, grid: OccupancyGrid, samples: np.ndarray, robot: tuple[float, float]) -> np.ndarray:
        """Grow by samples, shape (n, 2), float64, map frame [m]; a tree that resets starts again at the robot (x, y).

        Returns:
            Shape (k, 2), float64: the frontier points found, in the order of the samples, map frame [m].
        """
        count, scale = len(self.parents), grid.resolution
        vertices = np.empty((2, count + len(samples)), dtype=np.float32)
        parents = np.empty(count + len(samples), dtype=np.int32)
        origin = np.array(grid.origin)
        u, v = (np.array(robot) - origin) / scale
        vertices[:, :count] = (self._points - origin[:, None]) / scale
        parents[:count] = self.parents
        found = np.empty((len(samples), 2))
        eta, spacing, resets = self._rules
        rules = GrowthRules(eta / scale, spacing / scale, resets)
        count, num_found = grow(
            grid.data, (samples - origin) / scale, rules, (float(u), float(v)), vertices, parents, count, found
        )
        self._points = vertices[:, :count] * np.float64(scale) + origin[:, None]
        self.parents = parents[:count]
        return found[:num_found] * scale + origin
