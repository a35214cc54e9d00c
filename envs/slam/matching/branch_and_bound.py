"""Branch-and-bound scan matching: search for the pose of a scan that fits an occupancy grid best.

The search tree splits squares of position offsets (Hess et al., Real-time loop closure in 2D lidar SLAM, 2016, section
V). Occupancy maxima over such squares of cells give upper bounds of the scores inside.
"""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lookup import load

from .fields import FULL_PERCENT, Pyramid

NO_EXCLUSION = (0.0, 0.0, 0.0, -1.0, -1.0)
"""Region of excluded poses in a search, here empty: x, y [m], heading [rad], radius [m], half angle [rad]."""
NO_RANK = np.iinfo(np.int64).max


class SearchWindow(NamedTuple):
    """Offsets and headings tested in a branch-and-bound search."""

    half_width: float
    """Maximum offset along x and y [m]."""
    half_angle: float
    """Maximum difference from the initial heading [rad]."""
    angle_step: float


class SearchResult(NamedTuple):
    """Result of branch-and-bound scan matching."""

    pose: Pose2D | None
    """Best pose, frame of the grid; None if below the minimum score."""
    score: float
    """Mean occupancy at the scan points, from 0 to 1."""
    evaluations: int


class Grid(NamedTuple):
    """Scan points as cell indices of an occupancy grid, at each tested heading."""

    cells: np.ndarray
    """Flat cell index of each scan point, shape (num_headings, n), int32; without points far outside the grid."""
    counts: np.ndarray
    """Number of scan points in `cells` per heading, shape (num_headings,), int64."""
    reach: int
    num_turns: int


class _Best(NamedTuple):
    total: int
    rank: int
    turn: int
    row: int
    col: int


def angle_step(points: np.ndarray, resolution: float) -> float:
    """Return the heading step [rad] that moves three quarters of the scan points by at most 1.5 cells.

    `points`: shape (n, 2), n > 0, float32, base frame [m].
    """
    far = np.partition((points.astype(np.float64) ** 2).sum(axis=1), (3 * len(points)) // 4)[(3 * len(points)) // 4]
    return min(max(1.5 * resolution / max(math.sqrt(far), 1e-6), 0.006), 0.03)


@njit(cache=True, error_model="numpy")
def discretise(pyramid, points, pose, window, shift):
    """Return the grid cell of each scan point at each tested heading around `pose`.

    `shift` is subtracted from x and y [cells]. The window must not exceed the reach of the pyramid.
    """
    reach = round(window.half_width / pyramid.resolution)
    num_turns = math.floor(window.half_angle / window.angle_step + 1e-9)
    height, width = pyramid.levels.shape[1], pyramid.levels.shape[2]
    n = points.shape[0]
    cells, counts = np.empty((2 * num_turns + 1, n), dtype=np.int32), np.zeros(2 * num_turns + 1, dtype=np.int64)
    x = (pose[0] - pyramid.x) / pyramid.resolution - shift
    y = (pose[1] - pyramid.y) / pyramid.resolution - shift
    for turn in range(2 * num_turns + 1):
        theta = pose[2] + (turn - num_turns) * window.angle_step
        c, s = math.cos(theta) / pyramid.resolution, math.sin(theta) / pyramid.resolution
        count = 0
        for k in range(n):
            u, v = float(points[k, 0]), float(points[k, 1])
            col, row = math.floor(x + c * u - s * v), math.floor(y + s * u + c * v)
            if 0 <= col < width and reach <= row < height - reach:
                cells[turn, count] = row * width + col
                count += 1
        counts[turn] = count
    return Grid(cells, counts, reach, num_turns)


@njit(cache=True, error_model="numpy")
def total_at(level, grid, turn, offset):
    """Return the sum of occupancies at the scan points for a tested pose.

    `level`: flattened pyramid level. `turn`: index of the heading. `offset`: position offset in flat cell indices.
    """
    total = 0
    cells = grid.cells[turn]
    for k in range(grid.counts[turn]):
        total += int(load(level, np.uint64(cells[k] + offset)))
    return total


@njit(cache=True, error_model="numpy")
def _rank(grid, turn, row, col):
    side, turned = 2 * grid.reach + 1, turn - grid.num_turns
    order = 2 * abs(turned) - (1 if turned < 0 else 0)
    nearness = (row * row + col * col) * (2 * grid.num_turns + 1) + order
    return (nearness * side + row + grid.reach) * side + col + grid.reach


@njit(cache=True, error_model="numpy")
def _score_top(levels, width, grid, least, limit):
    top = levels.shape[0] - 1
    side = 1 << top
    per_axis = 2 * grid.reach // side + 1
    nodes = np.empty((grid.counts.shape[0] * per_axis * per_axis, 4), dtype=np.int64)
    count, evaluations = 0, 0
    for turn in range(grid.counts.shape[0]):
        for i in range(per_axis):
            for j in range(per_axis):
                if evaluations == limit:
                    return nodes[:0], evaluations
                row, col = i * side - grid.reach, j * side - grid.reach
                total = total_at(levels[top], grid, turn, row * width + col)
                evaluations += 1
                if total >= least:
                    nodes[count, 0], nodes[count, 1], nodes[count, 2], nodes[count, 3] = total, turn, row, col
                    count += 1
    return nodes[:count], evaluations


@njit(cache=True, error_model="numpy")
def _descend(levels, width, grid, node, best, budget, excluded):
    far, turn_out, max_turn = excluded[3] * excluded[3], excluded[2], excluded[4]
    top = levels.shape[0] - 1
    stack = np.empty((3 * top + 4, 5), dtype=np.int64)
    stack[0, :4], stack[0, 4] = node, top
    count, evaluations = 1, 0
    while count > 0:
        count -= 1
        total, turn, row, col, level = stack[count]
        if total < best.total:
            continue
        if level == 0:
            dx, dy = col - excluded[0], row - excluded[1]
            if abs(turn - turn_out) <= max_turn and dx * dx + dy * dy <= far:
                continue
            rank = _rank(grid, turn, row, col)
            if total > best.total or rank < best.rank:
                best = _Best(total, rank, turn, row, col)
            continue
        if evaluations + 4 > budget:
            return best, budget
        first, half = count, 1 << (level - 1)
        for child in range(4):
            r, c = row + half * (child // 2), col + half * (child % 2)
            if r > grid.reach or c > grid.reach:
                continue
            bound = total_at(levels[level - 1], grid, turn, r * width + c)
            evaluations += 1
            if bound < best.total:
                continue
            # Keep the best child on top of the stack.
            at = count
            while at > first and stack[at - 1, 0] >= bound:
                stack[at] = stack[at - 1]
                at -= 1
            stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3], stack[at, 4] = bound, turn, r, c, level - 1
            count += 1
    return best, evaluations


@njit(cache=True, error_model="numpy")
def _search_below(levels, width, grid, nodes, least, budget, excluded):
    best = _Best(least, NO_RANK, 0, 0, 0)
    evaluations = 0
    for k in range(nodes.shape[0]):
        if nodes[k, 0] < best.total:
            break
        best, scored = _descend(levels, width, grid, nodes[k], best, budget - evaluations, excluded)
        evaluations += scored
    return best, evaluations


def search(
    pyramid: Pyramid,
    points: np.ndarray,
    pose: Pose2D,
    window: SearchWindow,
    min_score: float,
    max_evaluations: int,
    excluded: tuple[float, float, float, float, float] = NO_EXCLUSION,
) -> SearchResult:
    """Return the best-fitting pose of scan points on an occupancy grid, in a search window.

    Tested poses differ by one cell or `window.angle_step`. `points`: shape (n, 2), float32, base frame [m]. `pose`:
    centre of the window, frame of the grid; ties go to the nearest pose. `min_score`: minimum mean occupancy at the
    points, from 0 to 1. `max_evaluations`: maximum number of scored squares of poses. `excluded`: region to skip.
    """
    grid = discretise(pyramid, points, tuple(pose), window, 0.0)
    width, levels = pyramid.levels.shape[2], pyramid.levels.reshape(len(pyramid.levels), -1)
    least = max(math.ceil(min_score * FULL_PERCENT * len(points) - 1e-9), 1)
    nodes, evaluations = _score_top(levels, width, grid, least, max_evaluations)
    nodes = nodes[np.argsort(-nodes[:, 0], kind="stable")]
    x, y, theta, radius, angle = excluded
    center = (x - pose[0]) / pyramid.resolution, (y - pose[1]) / pyramid.resolution
    turn = wrap_angle(theta - pose[2]) / window.angle_step + grid.num_turns
    out = (*center, turn, radius / pyramid.resolution, angle / window.angle_step)
    best, scored = _search_below(levels, width, grid, nodes, least, max_evaluations - evaluations, out)
    if best.rank == NO_RANK:
        return SearchResult(None, 0.0, evaluations + scored)
    x, y = pose[0] + best.col * pyramid.resolution, pose[1] + best.row * pyramid.resolution
    theta = wrap_angle(pose[2] + (best.turn - grid.num_turns) * window.angle_step)
    score = best.total / (FULL_PERCENT * len(points))
    return SearchResult(Pose2D(x, y, theta), score, evaluations + scored)
