"""The Monte Carlo scan matcher, and how to watch it at work."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lookup import load

from .grid_map import COUNT_BITS, ONE, GridMap, unvisited_word
from .params import TinySlamParams
from .scans import project_hits


class SearchParams(NamedTuple):
    """Spread and limits of a search; see `TinySlamParams`."""

    sigma_xy: float
    """Spread of positions at the start [cells]."""
    sigma_theta: float
    max_failed: int
    max_tries: int
    unvisited: int
    """Word of a cell never observed."""
    position_penalty: float = 0.0
    """Taken off the score for a candidate's squared distance from the predicted pose, fixed-point [1/cells^2]."""
    heading_penalty: float = 0.0
    """Taken off the score for its squared turn from there, fixed-point [1/rad^2]."""


class Search(NamedTuple):
    """Result of a search: the best pose, with x and y from the map's corner [cells, cells, rad]."""

    x: float
    y: float
    theta: float
    total: int
    """What `score` returned for the best pose, less its penalty."""
    tried: int
    """Candidates tried."""
    accepted: int
    """Candidates that were better than all before."""


class MatcherObserver(Protocol):
    """Is notified of every pose that the matcher tests, after the search.

    Costs are hits minus the sum of their cells' occupancies; with a prior, plus what it takes off.
    """

    def on_matching_start(self, pose: Pose2D) -> None:
        """A search begins at the predicted pose."""
        ...

    def on_scan_test(self, pose: Pose2D, cost: float) -> None:
        """A pose was tested, be it the predicted one."""
        ...

    def on_pose_update(self, pose: Pose2D, cost: float) -> None:
        """A pose was better than all before it."""
        ...

    def on_matching_end(self, pose: Pose2D, cost: float) -> None:
        """The search ended with this pose."""
        ...


def search_params(params: TinySlamParams) -> SearchParams:
    """Return the params of the search, in the cells of the map."""
    spread, limits = (params.sigma_xy / params.resolution, params.sigma_theta), (params.max_failed, params.max_tries)
    return SearchParams(*spread, *limits, unvisited_word(params.unvisited))


@njit(cache=True, error_model="numpy")
def score(words, unvisited, points, num_points, x, y, theta, indices):
    """Return the sum of the occupancies of the cells in which a scan's hits fall, fixed-point.

    The original's cost is the number of hits minus this sum; the best pose is the same. Outside the map nothing was
    ever observed. For the arguments see `match`; `indices`, shape (>= num_points,), uint32, is room to work in.
    """
    x32, y32 = np.float32(x), np.float32(y)
    c, s = np.float32(math.cos(theta)), np.float32(math.sin(theta))
    rows, cols, width = np.float32(words.shape[0]), np.float32(words.shape[1]), np.int32(words.shape[1])
    lowest = np.uint32(0xFFFFFFFF)
    for k in range(num_points):
        col = c * points[0, k] - s * points[1, k] + x32
        row = s * points[0, k] + c * points[1, k] + y32
        inside = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
        # Outside is 0, which a hit in the map's corner is as well: the loop below tells them apart.
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
def penalty(params, pose, x, y, theta):
    """Return what a candidate loses by its distance from the predicted pose, (x, y, theta) in cells, fixed-point."""
    dx, dy, turn = x - pose[0], y - pose[1], theta - pose[2]
    return round(params.position_penalty * (dx * dx + dy * dy) + params.heading_penalty * turn * turn)


@njit(cache=True, error_model="numpy")
def match(words, points, num_points, pose, params, noise, trace):
    """Search the pose at which a scan fits the map best.

    Candidates are drawn around the best pose so far. An improvement that comes after more than a third of the allowed
    failures halves the spread and forgives them.

    `words`: shape (height, width), int32, the map; `points`: shape (2, >= num_points), float32, the hits in the base
    frame [cells]; `pose`: predicted x, y from the map's corner [cells] and heading [rad]; `params`: `SearchParams`;
    `noise`: shape (max_tries, 3), float64, standard normal; `trace`: shape (max_tries + 1, 5), float64, written:
    predicted pose and candidates, as in `pose`, what `score` gave less the penalty, and whether that was better than
    all before.
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
        total -= penalty(params, pose, x, y, theta)
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
    """Do what `match` does for a scan, see `project_hits`, and a predicted pose (x, y, theta), map frame [m, m, rad].

    `corner` is column and row of the map's first cell, counted from the map frame's origin; `points`, shape (2,
    num_beams), float32, is room to work in. Returns the pose, map frame; the number of candidates tried; whether the
    pose is another than the predicted one; the number of hits.
    """
    resolution = geometry.resolution
    count = project_hits(ranges, geometry, points)
    start = (pose[0] / resolution - corner[0], pose[1] / resolution - corner[1], pose[2])
    found = match(words, points, count, start, params, noise, trace)
    if found.accepted == 0:
        return (pose[0], pose[1], pose[2]), found.tried, False, count
    x, y = (found.x + corner[0]) * resolution, (found.y + corner[1]) * resolution
    return (x, y, wrap_angle(found.theta)), found.tried, True, count


def notify(
    observers: Sequence[MatcherObserver], grid_map: GridMap, predicted: Pose2D, trace: np.ndarray, num_hits: int
) -> None:
    """Tell observers of a search by its trace, see `match`; `predicted` is in metres."""

    def tell(event: str, *said: Pose2D | float) -> None:
        for observer in observers:
            getattr(observer, event)(*said)

    tell("on_matching_start", predicted)
    best = predicted, num_hits - trace[0, 3] / ONE
    tell("on_scan_test", *best)
    for x, y, theta, total, is_better in trace[1:].tolist():
        pose, cost = Pose2D(*grid_map.to_metres(x, y), wrap_angle(theta)), num_hits - total / ONE
        tell("on_scan_test", pose, cost)
        if is_better:
            best = pose, cost
            tell("on_pose_update", *best)
    tell("on_matching_end", *best)
