"""Proposal distribution and importance weight of each particle.

The pose posterior is a Gaussian around the scan match (Grisetti, Stachniss and Burgard, 2007, section IV.B). Mean and
Hessian H come from Gauss-Newton matching instead of samples, for speed. With motion covariance P, residuals r_i of
variance k, and distance d of the mean from odometry,

    S = (P^-1 + H / k)^-1,    log w = -sum r_i^2 / 2k  -  d^T P^-1 d / 2  +  log(det S / det P) / 2,

where w is Laplace's approximation of equation (19).
"""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import distance, wrap_angle
from lidarnaut.envs.geometry.pose import compose

from ..matching.covariance import correct_covariance, predict_covariance
from ..matching.gauss_newton import evaluate, known_score_at, refine
from ..matching.scan_matcher import MIN_KNOWN_HITS, make_prior
from .tiles import TileMap, TilePool


class Maps(NamedTuple):
    """Maps of all particles, as tiles (square blocks of cells) in a shared pool."""

    pool: TilePool
    slots: np.ndarray
    """Slot number of each particle's map tiles in the pool, shape (num_particles, num_tiles), int32."""
    tiles_wide: int
    num_levels: int
    corner: tuple[int, int]
    resolution: float


class Proposals(NamedTuple):
    """Gaussian proposal distributions and importance weights of all particles."""

    modes: np.ndarray
    """Proposal means, shape (num_particles, 3), map frame [m, m, rad]."""
    covariances: np.ndarray
    """Proposal covariances, shape (num_particles, 3, 3) [m^2, rad^2]."""
    log_likelihoods: np.ndarray
    """Log importance weight of each particle for the current scan, up to a common constant, shape (num_particles,)."""
    num_known: np.ndarray
    known_scores: np.ndarray
    fits: np.ndarray

    @classmethod
    def make(cls, count: int) -> "Proposals":
        numbers = np.zeros(count), np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros(count, dtype=np.bool_)
        return cls(np.zeros((count, 3)), np.zeros((count, 3, 3)), *numbers)


@njit(cache=True, error_model="numpy")
def prior_cost(prior, x, y, theta):
    """Return d^T W d for the difference d between a pose [cells, cells, rad] and a Gaussian prior with weight W."""
    dx, dy, turn = x - prior.x, y - prior.y, theta - prior.theta
    own = prior.w_xx * dx * dx + prior.w_yy * dy * dy + prior.w_tt * turn * turn
    return own + 2.0 * (prior.w_xy * dx * dy + prior.w_xt * dx * turn + prior.w_yt * dy * turn)


@njit(cache=True, error_model="numpy")
def _propose(map, num_levels, points, num_points, start, prior, params, max_correction):
    over = (map, num_levels, points, num_points)
    x, y, theta, fit = refine(*over, start, prior, params.iterations, params.coarse_iterations)
    num_known, known_score = known_score_at(map, points, num_points, x, y, theta)
    fits = num_known < MIN_KNOWN_HITS or known_score >= params.min_known_score
    fits &= distance(x - prior.x, y - prior.y) <= max_correction
    if not fits:
        x, y, theta = prior.x, prior.y, prior.theta
    cost = evaluate(map, 0, points, num_points, x, y, theta).squares + prior_cost(prior, x, y, theta)
    return (x, y, theta), fit, -0.5 * cost / params.residual_variance, num_known, known_score, fits


@njit(cache=True, error_model="numpy")
def propose(maps, poses, motion, start_motion, stds, points, num_points, params, out):
    """Write the proposal distribution and importance weight of every particle to `out`.

    `poses`: particles at the last matched scan, shape (num_particles, 3), map frame [m, m, rad]. `motion`: odometry
    since then. `start_motion`: initial guess of the motion in scan matching. `stds`: odometry standard deviations [m],
    [rad]. `points`: scan points, shape (2, >= num_points), float32, base frame [cells].
    """
    resolution, (col, row) = maps.resolution, maps.corner
    occupancy, cells = maps.pool.occupancy.ravel(), maps.pool.occupancy.shape[1]
    for p in range(poses.shape[0]):
        x, y, theta = poses[p, 0], poses[p, 1], poses[p, 2]
        map = TileMap(occupancy, cells, maps.slots[p], maps.tiles_wide)
        by_odometry = compose(x, y, theta, motion[0], motion[1], motion[2])
        first = compose(x, y, theta, start_motion[0], start_motion[1], start_motion[2])
        covariance = out.covariances[p]
        covariance[:] = 0.0
        predict_covariance(covariance, 0.0, 0.0, stds[0], stds[1])
        expected = (by_odometry[0] / resolution - col, by_odometry[1] / resolution - row, by_odometry[2])
        prior = make_prior(expected, covariance, params.residual_variance, resolution)
        start_theta = by_odometry[2] + wrap_angle(first[2] - by_odometry[2])
        start = (first[0] / resolution - col, first[1] / resolution - row, start_theta)
        mode, fit, log_likelihood, out.num_known[p], out.known_scores[p], fits = _propose(
            map, maps.num_levels, points, num_points, start, prior, params, params.retry_distance / resolution
        )
        if fits:
            shrunk = correct_covariance(covariance, fit, num_points, params.residual_variance, resolution)
            log_likelihood += 0.5 * math.log(shrunk)
        out.modes[p, 0], out.modes[p, 1] = (mode[0] + col) * resolution, (mode[1] + row) * resolution
        out.modes[p, 2] = wrap_angle(mode[2])
        out.log_likelihoods[p], out.fits[p] = log_likelihood, fits


def take_better(proposals: Proposals, others: Proposals, least_gain: float) -> None:
    """Replace each particle's proposal by the one in `others` if this fits the map and scores higher.

    `least_gain`: minimum increase of the occupancy sum at the scan points.
    """
    before, after = (each.num_known * each.known_scores for each in (proposals, others))
    is_better = others.fits & (after > before + least_gain)
    for own, other in zip(proposals, others):
        own[is_better] = other[is_better]


def draw_poses(proposals: Proposals, noise: np.ndarray) -> np.ndarray:
    """Sample a pose from each particle's proposal, shape (num_particles, 3), float64, map frame [m, m, rad].

    `noise`: standard normal, shape (num_particles, 3).
    """
    drawn = np.einsum("pij,pj->pi", np.linalg.cholesky(proposals.covariances), noise)
    poses: np.ndarray = proposals.modes + drawn
    poses[:, 2] = (poses[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return poses
