import math
from typing import Any, NamedTuple, Self

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import distance, wrap_angle
from lidarnaut.envs.geometry.rows import write_row

from ..slam_params import MatchingParams
from .correlative import search_window
from .covariance import NoiseRecord, correct_covariance, invert, motion_stds, predict_covariance
from .distributions import refine_to_distributions
from .gauss_newton import Fit, PosePrior, known_score_at, refine

MIN_KNOWN_HITS = 20
"""Minimum number of scan points in known cells to judge a match."""
RETRY_GAIN = 0.05
"""Minimum gain to accept the wider search after a poor match: increase of the summed occupancy of known cells, per scan
point."""
NO_ODOMETRY_STD = 0.5
"""Standard deviation of the motion between two scans without odometry: of position [m], and of heading [rad]."""


class MatcherParams(NamedTuple):
    """Scan matching parameters for Numba kernels, with infinity instead of None."""

    odometry_noise: NoiseRecord
    uses_odometry: bool
    uses_distributions: bool
    residual_variance: float
    iterations: int
    coarse_iterations: int
    search_distance: float
    search_angle: float
    retry_below: float
    retry_distance: float
    retry_angle: float
    min_known_score: float

    @classmethod
    def of(cls, params: MatchingParams) -> Self:
        values = [getattr(params, name) for name in cls._fields[1:]]
        numbers: list[Any] = [math.inf if value is None else value for value in values]
        return cls(NoiseRecord.of(params.odometry_noise), *numbers)

    def in_contact(self, slip: float) -> Self:
        """Return parameters with more noise and an exhaustive search for odometry with `slip` [m] in contact."""
        if slip == 0.0 or not self.uses_odometry:
            return self
        return self._replace(odometry_noise=self.odometry_noise.in_contact(slip), search_distance=-1.0)


class Match(NamedTuple):
    """Result of matching a scan to a map."""

    x: float
    y: float
    theta: float
    is_judged: bool
    """Whether enough scan points are in known cells to judge the match."""
    fits: bool
    """Whether mean occupancy at the scan points is high enough; True if the match cannot be judged."""
    num_hits: int
    fit: Fit
    is_far: bool
    """Whether the second, wider search found the pose."""


@njit(cache=True, error_model="numpy")
def make_prior(pose, covariance, residual_variance, resolution):
    """Return the Gaussian prior of scan matching from a predicted pose [cells, cells, rad] and its covariance [m, rad].

    The weight matrix is the residual variance times the inverse covariance.
    """
    w = np.empty((3, 3))
    invert(covariance, w)
    k, mixed, square = residual_variance, residual_variance * resolution, residual_variance * resolution * resolution
    w_xx, w_xy, w_yy = square * w[0, 0], square * w[0, 1], square * w[1, 1]
    return PosePrior(pose[0], pose[1], pose[2], w_xx, w_xy, mixed * w[0, 2], w_yy, mixed * w[1, 2], k * w[2, 2])


@njit(cache=True, error_model="numpy")
def match_to_levels(ranges, geometry, levels, sums, corner, last, predicted, params, covariance, points):
    """Match a scan, shape (num_beams,), float32 [m], to a map by correlative search and Gauss-Newton.

    `levels`: occupancy grids, finest first. `sums`: see `distributions.add_points`. `corner`: column and row of the
    first cell from the map frame's origin. `last`: pose at the last matched scan; `predicted`: odometry pose; map frame
    [m, m, rad]. `covariance`, shape (3, 3), float64 [m, rad], is updated to the match, or to the prediction if the scan
    does not fit.
    """
    resolution = geometry.resolution
    dx, dy, turn = predicted[0] - last[0], predicted[1] - last[1], wrap_angle(predicted[2] - last[2])
    travelled = distance(dx, dy)
    position_std, heading_std = motion_stds(params.odometry_noise, travelled, turn)
    if not params.uses_odometry:
        predicted, dx, dy, position_std, heading_std = last, 0.0, 0.0, NO_ODOMETRY_STD, NO_ODOMETRY_STD
    count = project_hits(ranges, geometry, points)
    start = (predicted[0] / resolution - corner[0], predicted[1] / resolution - corner[1], predicted[2])
    predict_covariance(covariance, dx, dy, position_std, heading_std)
    prior = make_prior(start, covariance, params.residual_variance, resolution)
    num_levels, steps, finest_steps = len(levels), params.coarse_iterations, params.iterations
    coarse = min(1, num_levels - 1)
    over, pose = (levels[coarse], 0.5**coarse, points, count, start), start
    stds = (position_std / resolution, heading_std)
    if count > 0 and (travelled > params.search_distance or abs(turn) > params.search_angle):
        pose = search_window(*over, stds, 50)
    x, y, theta, fit = refine(levels, num_levels, points, count, pose, prior, finest_steps, steps)
    num_known, known_score = known_score_at(levels, points, count, x, y, theta)
    is_far = False
    if num_known >= MIN_KNOWN_HITS and known_score < params.retry_below:
        # The prediction failed, and its covariance is too small. Unknown cells count as 0, because they would attract a
        # wide search.
        pose = search_window(*over, (0.5 * (params.retry_distance / resolution), 0.5 * params.retry_angle), 0)
        wide = np.zeros((3, 3))
        predict_covariance(wide, 0.0, 0.0, params.retry_distance, params.retry_angle)
        prior = make_prior(start, wide, params.residual_variance, resolution)
        found = refine(levels, num_levels, points, count, pose, prior, finest_steps, steps)
        there = known_score_at(levels, points, count, found[0], found[1], found[2])
        if there[0] * there[1] > num_known * known_score + RETRY_GAIN * count:
            x, y, theta, fit = found
            num_known, known_score = there
            write_row(covariance.ravel(), wide.ravel())
            is_far = True
    is_judged = num_known >= MIN_KNOWN_HITS
    fits = not is_judged or known_score >= params.min_known_score
    if fits:
        if params.uses_distributions:
            x, y, theta = refine_to_distributions(
                sums, points, count, num_known, (x, y, theta), prior, params.residual_variance
            )
        correct_covariance(covariance, fit, count, params.residual_variance, resolution)
    x, y = (x + corner[0]) * resolution, (y + corner[1]) * resolution
    return Match(x, y, wrap_angle(theta), is_judged, fits, count, fit, is_far)
