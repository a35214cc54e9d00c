"""The Monte Carlo scan matcher."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry.lookup import load
from envs.geometry.pose import wrap_angle

from .cells import COUNT_BITS, unvisited_word
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
    """State of a search: the best pose so far, with x and y from the map's corner [cells, cells, rad]."""

    x: float
    y: float
    theta: float
    total: int
    """What `score` returned for the best pose."""
    spread: float = 1.0
    """Factor of the spread of candidates."""
    failed: int = 0
    """Failures that are not forgiven."""
    tried: int = 0
    """Candidates tried."""
    accepted: int = 0
    """Candidates that were better than all before."""


def search_params(params: TinySlamParams) -> SearchParams:
    """Return the params of the search, in the cells of the map."""
    return SearchParams(
        *(params.sigma_xy / params.resolution, float(params.sigma_theta), params.max_failed, params.max_tries),
        unvisited=unvisited_word(params.unvisited),
    )


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
def draw_candidate(search, params, noise):
    """Return the next candidate of a search as (x, y, theta), drawn around the best pose so far; see `match`."""
    dx, dy, turn = noise[search.tried, 0], noise[search.tried, 1], noise[search.tried, 2]
    sigma_xy, sigma_theta = search.spread * params.sigma_xy, search.spread * params.sigma_theta
    return search.x + sigma_xy * dx, search.y + sigma_xy * dy, search.theta + sigma_theta * turn


@njit(cache=True, error_model="numpy")
def judge_candidate(search, params, x, y, theta, total):
    """Return the state of a search after a candidate whose `score` is `total`.

    An improvement that comes after more than a third of the allowed failures halves the spread and forgives them.
    """
    spread, failed, tried, accepted = search.spread, search.failed, search.tried + 1, search.accepted
    if total <= search.total:
        return Search(search.x, search.y, search.theta, search.total, spread, failed + 1, tried, accepted)
    if failed > params.max_failed // 3:
        spread, failed = 0.5 * spread, 0
    return Search(x, y, theta, total, spread, failed, tried, accepted + 1)


@njit(cache=True, error_model="numpy")
def match(words, points, num_points, pose, params, noise):
    """Search the pose at which a scan fits the map best.

    Args:
        words: shape (height, width), int32, the map.
        points: shape (2, >= num_points), float32, the hits in the base frame [cells].
        num_points: number of hits.
        pose: predicted x, y from the map's corner [cells] and heading [rad].
        params: `SearchParams`.
        noise: shape (max_tries, 3), float64, standard normal.

    Returns:
        `Search`, at its end.
    """
    indices = np.empty(points.shape[1], dtype=np.uint32)
    x, y, theta = pose
    total = score(words, params.unvisited, points, num_points, x, y, theta, indices)
    search = Search(x, y, theta, total, 1.0, 0, 0, 0)
    while search.failed < params.max_failed and search.tried < params.max_tries:
        x, y, theta = draw_candidate(search, params, noise)
        total = score(words, params.unvisited, points, num_points, x, y, theta, indices)
        total -= penalty(params, pose, x, y, theta)
        search = judge_candidate(search, params, x, y, theta, total)
    return search


@njit(cache=True, error_model="numpy")
def match_scan(ranges, geometry, words, corner, pose, params, noise, points):
    """Search the pose at which a scan fits the map best; see `match`.

    Args:
        ranges: shape (num_beams,), float32 [m], as in `project_hits`.
        geometry: `ScanGeometry`.
        words: shape (height, width), int32, the map.
        corner: column and row of the map's first cell, counted from the map frame's origin.
        pose: predicted pose (x, y, theta), map frame [m, m, rad].
        params: `SearchParams`.
        noise: shape (max_tries, 3), float64, standard normal.
        points: shape (2, num_beams), float32: room to work in.

    Returns:
        The pose (x, y, theta), map frame, and whether it is another than the predicted one.
    """
    resolution = geometry.resolution
    count = project_hits(ranges, geometry, points)
    start = (pose[0] / resolution - corner[0], pose[1] / resolution - corner[1], pose[2])
    found = match(words, points, count, start, params, noise)
    if found.accepted:
        x, y = (found.x + corner[0]) * resolution, (found.y + corner[1]) * resolution
        return x, y, wrap_angle(found.theta), True
    return pose[0], pose[1], pose[2], False
