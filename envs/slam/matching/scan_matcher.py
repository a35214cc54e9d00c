"""One scan matched to a log-odds map: a search where odometry may be far off, Gauss-Newton, and the covariance."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry import wrap_angle
from envs.geometry.pose import distance

from ..hector_params import HectorParams
from ..motion_noise import NoiseRecord, motion_stds
from ..scans import project_hits
from .correlative import SearchWindow, search_window
from .covariance import correct_covariance, invert, predict_covariance
from .gauss_newton import Fit, Prior, refine

WINDOW = 2.0
"""Half width of the search window in standard deviations of the predicted pose."""
NEVER = 1e9
"""Motion at which a search would begin that never does."""
FREE = 1e6
"""Standard deviation of a pose that nothing predicts [m] or [rad]."""


class MatcherParams(NamedTuple):
    """What the matcher reads of `HectorParams`."""

    uses_odometry: bool
    noise: NoiseRecord
    residual_variance: float
    iterations: int
    coarse_iterations: int
    search_distance: float
    search_angle: float
    retry_below: float
    retry_distance: float
    retry_angle: float
    retry_gain: float
    min_known_hits: int
    min_known_score: float

    @classmethod
    def of(cls, params: HectorParams) -> "MatcherParams":
        """Return what a matcher with these params reads."""
        return cls(
            uses_odometry=params.uses_odometry,
            noise=NoiseRecord.of(params.odometry_noise),
            residual_variance=float(params.residual_variance),
            iterations=params.iterations,
            coarse_iterations=params.coarse_iterations,
            search_distance=NEVER if params.search_distance is None else float(params.search_distance),
            search_angle=NEVER if params.search_angle is None else float(params.search_angle),
            retry_below=float(params.retry_below),
            retry_distance=float(params.retry_distance),
            retry_angle=float(params.retry_angle),
            retry_gain=float(params.retry_gain),
            min_known_hits=params.min_known_hits,
            min_known_score=float(params.min_known_score),
        )


class Match(NamedTuple):
    """Where a scan fits the map."""

    x: float
    """Position, map frame [m]."""
    y: float
    """Position, map frame [m]."""
    theta: float
    """Heading, map frame, in [-pi, pi) [rad]."""
    score: float
    """Mean occupancy under the hits, from 0 to 1; 0 without hits."""
    num_known: int
    """Hits that fall in known cells."""
    known_score: float
    """Mean occupancy of those cells, from 0 to 1; 0 without any."""
    is_judged: bool
    """Whether enough hits fall in known cells to tell whether the scan fits; see `min_known_hits` of `HectorParams`."""
    fits: bool
    """Whether nothing speaks against the pose; see `min_known_score` of `HectorParams`."""
    num_hits: int
    """Hits of the scan."""
    fit: Fit
    """What they say at the pose."""
    is_far: bool
    """Whether the second search found the pose, of which odometry knew nothing; see `retry_below` of `HectorParams`."""


@njit(cache=True, error_model="numpy")
def known_score_at(occupancy, points, num_points, x, y, theta):
    """Return how many hits fall in known cells, and the mean occupancy of these from 0 to 1.

    `occupancy` has shape (height, width), int8; `points` shape (2, n), float32, base frame [cells]; x and y are counted
    from the map's corner [cells].
    """
    height, width = occupancy.shape
    c, s = math.cos(theta), math.sin(theta)
    count = total = 0
    for k in range(num_points):
        p_x, p_y = float(points[0, k]), float(points[1, k])
        u, v = c * p_x - s * p_y + x, s * p_x + c * p_y + y
        if u >= 0.0 and v >= 0.0 and u < width and v < height:
            value = occupancy[int(v), int(u)]
            if value >= 0:
                count += 1
                total += value
    return count, 0.01 * total / max(count, 1)


@njit(cache=True, error_model="numpy")
def make_prior(pose, covariance, residual_variance, resolution):
    """Return the prior of a predicted pose, x, y [cells] and heading, with its covariance [m, rad]: W = k P^-1."""
    w = np.empty((3, 3))
    invert(covariance, w)
    k, mixed, square = residual_variance, residual_variance * resolution, residual_variance * resolution * resolution
    w_xx, w_xy, w_yy = square * w[0, 0], square * w[0, 1], square * w[1, 1]
    return Prior(pose[0], pose[1], pose[2], w_xx, w_xy, mixed * w[0, 2], w_yy, mixed * w[1, 2], k * w[2, 2])


@njit(cache=True, error_model="numpy")
def match_to_levels(ranges, geometry, levels, corner, last, predicted, params, covariance, points):
    """Find the pose at which a scan fits a map.

    Args:
        ranges: shape (num_beams,), float32 [m], as in `project_hits`.
        geometry: `ScanGeometry`.
        levels: see `refine`.
        corner: column and row of the finest map's first cell, counted from the map frame's origin.
        last: pose (x, y, theta) of the last matched scan, map frame [m, m, rad].
        predicted: pose by odometry since then, map frame [m, m, rad]; not used without odometry.
        params: `MatcherParams`.
        covariance: shape (3, 3), float64 [m, rad]: that of the last pose; written: that of the match, or, of a scan
            that does not fit, that of the predicted pose.
        points: shape (2, num_beams), float32: room to work in.

    Returns:
        `Match`.
    """
    resolution = geometry.resolution
    dx, dy, turn = predicted[0] - last[0], predicted[1] - last[1], wrap_angle(predicted[2] - last[2])
    travelled = distance(dx, dy)
    position_std, heading_std = motion_stds(params.noise, travelled, turn)
    if not params.uses_odometry:
        predicted, position_std, heading_std = last, FREE, FREE
    count = project_hits(ranges, geometry, points)
    start = (predicted[0] / resolution - corner[0], predicted[1] / resolution - corner[1], predicted[2])
    predict_covariance(covariance, dx, dy, position_std, heading_std)
    prior = make_prior(start, covariance, params.residual_variance, resolution)
    coarse = min(1, len(levels) - 1)
    over, pose = (levels[coarse], 0.5**coarse, points, count, start), start
    stds = (position_std / resolution, heading_std)
    if count > 0 and (travelled > params.search_distance or abs(turn) > params.search_angle):
        pose = search_window(*over, SearchWindow(WINDOW * stds[0], WINDOW * stds[1], stds[0], stds[1], 50))
    x, y, theta, fit = refine(levels, points, count, pose, prior, params.iterations, params.coarse_iterations)
    num_known, known_score = known_score_at(levels[0], points, count, x, y, theta)
    is_far = False
    if num_known >= params.min_known_hits and known_score < params.retry_below:
        # The prediction has failed, and with it the covariance that would hold the pose there. Unknown cells count
        # nothing: they would draw a search as wide as this one.
        far, around = params.retry_distance / resolution, params.retry_angle
        pose = search_window(*over, SearchWindow(far, around, 0.5 * far, 0.5 * around, 0))
        wide = np.diag(np.array([params.retry_distance, params.retry_distance, around]) ** 2)
        prior = make_prior(start, wide, params.residual_variance, resolution)
        found = refine(levels, points, count, pose, prior, params.iterations, params.coarse_iterations)
        there = known_score_at(levels[0], points, count, found[0], found[1], found[2])
        if there[0] * there[1] > num_known * known_score + params.retry_gain * count:
            x, y, theta, fit = found
            num_known, known_score = there
            covariance[:] = wide
            is_far = True
    is_judged = num_known >= params.min_known_hits
    fits = not is_judged or known_score >= params.min_known_score
    if fits:
        correct_covariance(covariance, fit, count, params.residual_variance, resolution)
    x, y = (x + corner[0]) * resolution, (y + corner[1]) * resolution
    score = fit.total / max(count, 1)
    return Match(x, y, wrap_angle(theta), score, num_known, known_score, is_judged, fits, count, fit, is_far)
