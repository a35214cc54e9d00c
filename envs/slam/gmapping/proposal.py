"""The proposal distribution of each particle, and its importance weight.

The posterior of a particle's pose, given its map, odometry and the scan, is approximated by a Gaussian around the pose
where the scan fits best (Grisetti, Stachniss and Burgard, 2007, section IV.B). Mode and covariance come from the
Gauss-Newton matcher with odometry as prior (`matching.gauss_newton`), not from sampled points as in the paper: the
Hessian is there already, and dozens of evaluations for each particle are saved. With P the covariance of the motion
model, r_i the residuals of the hits, k their variance and d the distance of the mode from the pose by odometry,

    S = (P^-1 + H / k)^-1,    log w = -sum r_i^2 / 2k  -  d^T P^-1 d / 2  +  log(det S / det P) / 2,

where w is Laplace's approximation of the integral that is equation (19) of the paper.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry import Pose2D, wrap_angle
from envs.geometry.pose import compose, distance

from ..matching.covariance import correct_covariance, predict_covariance
from ..matching.scan_matcher import make_prior
from .params import GMappingParams
from .tile_matching import TileMap, judge, refine_tiles
from .tiles import TilePool


class ProposalParams(NamedTuple):
    """What proposals need of `GMappingParams`."""

    residual_variance: float
    iterations: int
    coarse_iterations: int
    min_known_hits: int
    min_known_score: float
    max_correction: float
    """Farthest from the pose by odometry that a mode is believed [m]."""

    @classmethod
    def of(cls, params: GMappingParams) -> "ProposalParams":
        """Return what proposals with these params need."""
        return cls(
            residual_variance=float(params.residual_variance),
            iterations=params.iterations,
            coarse_iterations=params.coarse_iterations,
            min_known_hits=params.min_known_hits,
            min_known_score=float(params.min_known_score),
            max_correction=float(params.retry_distance),
        )


class Maps(NamedTuple):
    """The maps of all particles."""

    pool: TilePool
    slots: np.ndarray
    """Shape (num_particles, num_tiles), int32: where the tiles of the maps lie in the pool."""
    tiles_wide: int
    """Number of tiles in a row."""
    num_levels: int
    corner: tuple[int, int]
    """Column and row of the first cell, counted from the map frame's origin."""
    resolution: float
    """Side of a cell of the finest level [m]."""


class Motion(NamedTuple):
    """The motion since the last key scan, as seen from the pose then."""

    odometry: Pose2D
    """By odometry."""
    start: Pose2D
    """From where the matches start."""
    position_std: float
    """Standard deviation of odometry's position along either axis [m]."""
    heading_std: float
    """Standard deviation of its heading [rad]."""


class Proposals(NamedTuple):
    """Proposal distributions and importance weights, a row for each particle."""

    modes: np.ndarray
    """Shape (num_particles, 3), float64: poses, map frame [m, m, rad]."""
    covariances: np.ndarray
    """Shape (num_particles, 3, 3), float64 [m, rad]."""
    log_likelihoods: np.ndarray
    """Shape (num_particles,), float64: logarithms of the importance weights, up to what all have in common."""
    num_known: np.ndarray
    """Shape (num_particles,), int64: hits in known cells."""
    known_scores: np.ndarray
    """Shape (num_particles,), float64: mean occupancy of those cells, from 0 to 1."""
    fits: np.ndarray
    """Shape (num_particles,), bool: whether nothing speaks against the mode."""

    @classmethod
    def make(cls, count: int) -> "Proposals":
        """Return room for as many particles."""
        return cls(
            np.zeros((count, 3)),
            np.zeros((count, 3, 3)),
            np.zeros(count),
            np.zeros(count, dtype=np.int64),
            np.zeros(count),
            np.zeros(count, dtype=np.bool_),
        )


@njit(cache=True, error_model="numpy")
def determinant(p):
    """Return the determinant of a symmetric matrix of shape (3, 3)."""
    m_xx, m_xy = p[1, 1] * p[2, 2] - p[1, 2] * p[1, 2], p[0, 2] * p[1, 2] - p[0, 1] * p[2, 2]
    return p[0, 0] * m_xx + p[0, 1] * m_xy + p[0, 2] * (p[0, 1] * p[1, 2] - p[0, 2] * p[1, 1])


@njit(cache=True, error_model="numpy")
def prior_cost(prior, x, y, theta):
    """Return d^T W d of a pose, x, y [cells] and heading [rad]; see `Prior`."""
    dx, dy, turn = x - prior.x, y - prior.y, theta - prior.theta
    own = prior.w_xx * dx * dx + prior.w_yy * dy * dy + prior.w_tt * turn * turn
    return own + 2.0 * (prior.w_xy * dx * dy + prior.w_xt * dx * turn + prior.w_yt * dy * turn)


@njit(cache=True, error_model="numpy")
def _propose(map, points, num_points, start, prior, params, max_correction):
    """Match a scan to the map of one particle.

    Args:
        map: `TileMap`.
        points: as for `propose`.
        num_points: as for `propose`.
        start: pose that the match starts from, x, y from the map's corner [cells] and heading [rad].
        prior: `Prior` by odometry.
        params: `ProposalParams`.
        max_correction: as in `ProposalParams` [cells].

    Returns:
        Mode x, y from the map's corner [cells] and heading [rad], `Fit`, log likelihood but for the covariances,
        `Judgement`, and whether it fits.
    """
    k = params.residual_variance
    x, y, theta, fit = refine_tiles(map, points, num_points, start, prior, params.iterations, params.coarse_iterations)
    found = judge(map, points, num_points, x, y, theta)
    fits = found.num_known < params.min_known_hits or found.known_score >= params.min_known_score
    fits &= distance(x - prior.x, y - prior.y) <= max_correction
    log_likelihood = -0.5 * (found.squares + prior_cost(prior, x, y, theta)) / k
    if not fits:
        x, y, theta = prior.x, prior.y, prior.theta
        log_likelihood = -0.5 * judge(map, points, num_points, x, y, theta).squares / k
    return x, y, theta, fit, log_likelihood, found, fits


@njit(cache=True, error_model="numpy")
def propose(maps, poses, motion, points, num_points, params, out):
    """Find proposal distribution and importance weight of every particle.

    Args:
        maps: `Maps`.
        poses: shape (num_particles, 3), float64, at the last key scan, map frame [m, m, rad].
        motion: `Motion` since then.
        points: shape (2, >= num_points), float32, hits in the base frame [cells].
        num_points: number of hits.
        params: `ProposalParams`.
        out: `Proposals`, written.
    """
    resolution, (col, row) = maps.resolution, maps.corner
    occupancy, cells = maps.pool.occupancy.ravel(), maps.pool.occupancy.shape[1]
    for p in range(poses.shape[0]):
        x, y, theta = poses[p, 0], poses[p, 1], poses[p, 2]
        map = TileMap(occupancy, cells, maps.slots[p], maps.tiles_wide, maps.num_levels)
        by_odometry = compose(x, y, theta, motion.odometry[0], motion.odometry[1], motion.odometry[2])
        first = compose(x, y, theta, motion.start[0], motion.start[1], motion.start[2])
        covariance = out.covariances[p]
        covariance[:] = 0.0
        predict_covariance(covariance, 0.0, 0.0, motion.position_std, motion.heading_std)
        expected = (by_odometry[0] / resolution - col, by_odometry[1] / resolution - row, by_odometry[2])
        prior = make_prior(expected, covariance, params.residual_variance, resolution)
        start_theta = by_odometry[2] + wrap_angle(first[2] - by_odometry[2])
        start = (first[0] / resolution - col, first[1] / resolution - row, start_theta)
        x, y, theta, fit, log_likelihood, found, fits = _propose(
            map, points, num_points, start, prior, params, params.max_correction / resolution
        )
        if fits:
            before = determinant(covariance)
            correct_covariance(covariance, fit, num_points, params.residual_variance, resolution)
            log_likelihood += 0.5 * math.log(determinant(covariance) / before)
        out.modes[p, 0], out.modes[p, 1] = (x + col) * resolution, (y + row) * resolution
        out.modes[p, 2] = wrap_angle(theta)
        out.log_likelihoods[p], out.fits[p] = log_likelihood, fits
        out.num_known[p], out.known_scores[p] = found.num_known, found.known_score


@njit(cache=True, error_model="numpy")
def take_better(proposals, others, least_gain):
    """Replace proposals by others that fit, and whose hits fall on occupancies greater by `least_gain` in sum."""
    for p in range(proposals.fits.shape[0]):
        before = proposals.num_known[p] * proposals.known_scores[p]
        if others.fits[p] and others.num_known[p] * others.known_scores[p] > before + least_gain:
            proposals.modes[p], proposals.covariances[p] = others.modes[p], others.covariances[p]
            proposals.log_likelihoods[p], proposals.fits[p] = others.log_likelihoods[p], others.fits[p]
            proposals.num_known[p], proposals.known_scores[p] = others.num_known[p], others.known_scores[p]


@njit(cache=True, error_model="numpy")
def draw_poses(proposals, noise, out):
    """Draw a pose from each proposal distribution: mode + L z, with L L^T the covariance (Cholesky).

    Args:
        proposals: `Proposals`.
        noise: shape (num_particles, 3), float64, standard normal: z; zeros take the mode.
        out: shape (num_particles, 3), float64, written: poses, map frame [m, m, rad].
    """
    for p in range(out.shape[0]):
        s, z = proposals.covariances[p], noise[p]
        l_xx = math.sqrt(s[0, 0])
        l_yx, l_tx = s[0, 1] / l_xx, s[0, 2] / l_xx
        l_yy = math.sqrt(max(s[1, 1] - l_yx * l_yx, 0.0))
        l_ty = (s[1, 2] - l_yx * l_tx) / l_yy if l_yy > 0.0 else 0.0
        l_tt = math.sqrt(max(s[2, 2] - l_tx * l_tx - l_ty * l_ty, 0.0))
        out[p, 0] = proposals.modes[p, 0] + l_xx * z[0]
        out[p, 1] = proposals.modes[p, 1] + l_yx * z[0] + l_yy * z[1]
        out[p, 2] = wrap_angle(proposals.modes[p, 2] + l_tx * z[0] + l_ty * z[1] + l_tt * z[2])
