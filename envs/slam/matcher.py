import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lookup import load

from .grid_map import COUNT_BITS


class SearchParams(NamedTuple):
    """Sampling spread, limits and penalties of Monte Carlo scan matching."""

    sigma_xy: float
    """Initial standard deviation of sampled positions [cells]."""
    sigma_theta: float
    max_failed: int
    max_tries: int
    unvisited: int
    position_penalty: float = 0.0
    """Score penalty per squared distance from the predicted pose [1/cells^2]; a fully occupied cell scores 2^18."""
    heading_penalty: float = 0.0


class Search(NamedTuple):
    """Result of Monte Carlo scan matching: best pose, from the map's corner [cells, cells, rad]."""

    x: float
    y: float
    theta: float
    total: int
    tried: int
    accepted: int


Tested = tuple[Pose2D, float]
"""Tested pose, map frame, and its cost."""


class MatcherObserver(Protocol):
    """Function that receives the poses tested in scan matching, map frame [m, m, rad], after each search.

    TinySLAM reports sampled poses, Hector and graph SLAM Gauss-Newton steps on the finest map, GMapping the matched
    poses of its particles. Cost is the number of scan points minus the sum of map occupancies at the points; TinySLAM
    adds the prior penalty.
    """

    def __call__(self, predicted: Pose2D, tested: Sequence[Tested], result: Tested) -> None:
        """Receive the predicted pose, the tested poses in order, and the resulting one, each with its cost."""


class MatcherTrace:
    """Observer that keeps the poses tested for the last scan; pictures show them."""

    def __init__(self) -> None:
        self.tested: list[tuple[float, ...]] = []
        """Poses x, y, heading, map frame [m, m, rad], and their costs."""

    def __call__(self, predicted: Pose2D, tested: Sequence[Tested], result: Tested) -> None:
        self.tested = [(*pose, cost) for pose, cost in tested]


@njit(cache=True, error_model="numpy")
def score(words, unvisited, points, num_points, x, y, theta, indices):
    """Return the sum of map occupancies at the scan points for a pose [cells, cells, rad]; 2^18 is one occupied cell.

    Points outside the map count as unobserved. `words`: packed map cells. `points`: shape (2, >= num_points), float32,
    base frame [cells].
    """
    x32, y32 = np.float32(x), np.float32(y)
    c, s = np.float32(math.cos(theta)), np.float32(math.sin(theta))
    rows, cols, width = np.float32(words.shape[0]), np.float32(words.shape[1]), np.int32(words.shape[1])
    lowest = np.uint32(0xFFFFFFFF)
    for k in range(num_points):
        col = c * points[0, k] - s * points[1, k] + x32
        row = s * points[0, k] + c * points[1, k] + y32
        inside = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
        # Index 0 means outside or the map's corner; outside points are corrected below.
        index = np.uint32(np.int32(row) * width + np.int32(col) if inside else 0)
        indices[k] = index
        lowest = min(lowest, index)
    flat = words.ravel()
    total = 0
    for k in range(num_points):
        total += load(flat, indices[k]) >> COUNT_BITS
    if lowest == 0:
        for k in range(num_points):
            if indices[k] == 0:
                col = c * points[0, k] - s * points[1, k] + x32
                row = s * points[0, k] + c * points[1, k] + y32
                if col < 0 or row < 0 or col >= cols or row >= rows:
                    total += (unvisited >> COUNT_BITS) - (flat[0] >> COUNT_BITS)
    return total


@njit(cache=True, error_model="numpy")
def match(words, points, num_points, pose, params, noise, trace):
    """Find the best pose of a scan in a map by random sampling around the best pose so far.

    `points`: scan points, shape (2, >= num_points), float32, base frame [cells]. `pose`: x, y from the map's corner
    [cells] and heading [rad]. `noise`: standard normal, shape (max_tries, 3). `trace` receives poses, scores and
    improvement flags, shape (max_tries + 1, 5).
    """
    indices = np.empty(points.shape[1], dtype=np.uint32)
    best = score(words, params.unvisited, points, num_points, pose[0], pose[1], pose[2], indices)
    best_x, best_y, best_theta = pose
    trace[0, 0], trace[0, 1], trace[0, 2], trace[0, 3], trace[0, 4] = best_x, best_y, best_theta, best, 0.0
    spread, failed, tried, accepted = 1.0, 0, 0, 0
    while failed < params.max_failed and tried < params.max_tries:
        sigma_xy, sigma_theta = spread * params.sigma_xy, spread * params.sigma_theta
        x, y = best_x + sigma_xy * noise[tried, 0], best_y + sigma_xy * noise[tried, 1]
        theta = best_theta + sigma_theta * noise[tried, 2]
        total = score(words, params.unvisited, points, num_points, x, y, theta, indices)
        dx, dy, turn = x - pose[0], y - pose[1], theta - pose[2]
        total -= round(params.position_penalty * (dx * dx + dy * dy) + params.heading_penalty * turn * turn)
        tried += 1
        is_better = total > best
        trace[tried, 0], trace[tried, 1], trace[tried, 2], trace[tried, 3] = x, y, theta, total
        trace[tried, 4] = is_better
        if not is_better:
            failed += 1
            continue
        best, best_x, best_y, best_theta = total, x, y, theta
        accepted += 1
        if failed > params.max_failed // 3:
            spread, failed = 0.5 * spread, 0
    return Search(best_x, best_y, best_theta, best, tried, accepted)


@njit(cache=True, error_model="numpy")
def match_scan(ranges, geometry, words, corner, pose, params, noise, points, trace):
    """Match a scan, shape (num_beams,), float32 [m], to a map by sampling around a predicted pose, map frame.

    Returns pose, number of samples, improvement flag, and number of scan points.
    """
    resolution = geometry.resolution
    count = project_hits(ranges, geometry, points)
    start = (pose[0] / resolution - corner[0], pose[1] / resolution - corner[1], pose[2])
    found = match(words, points, count, start, params, noise, trace)
    if found.accepted == 0:
        return (pose[0], pose[1], pose[2]), found.tried, False, count
    x, y = (found.x + corner[0]) * resolution, (found.y + corner[1]) * resolution
    return (x, y, wrap_angle(found.theta)), found.tried, True, count
