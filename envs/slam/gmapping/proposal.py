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

from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.geometry.pose import compose, distance

from ..matching.covariance import correct_covariance, predict_covariance
from ..matching.gauss_newton import evaluate, known_score_at, refine
from ..matching.scan_matcher import make_prior
from .tiles import TileMap, TilePool


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
        numbers = np.zeros(count), np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros(count, dtype=np.bool_)
        return cls(np.zeros((count, 3)), np.zeros((count, 3, 3)), *numbers)


@njit(cache=True, error_model="numpy")
def prior_cost(prior, x, y, theta):
    """Return d^T W d of a pose, x, y [cells] and heading [rad]; see `PosePrior`."""
    dx, dy, turn = x - prior.x, y - prior.y, theta - prior.theta
    own = prior.w_xx * dx * dx + prior.w_yy * dy * dy + prior.w_tt * turn * turn
    return own + 2.0 * (prior.w_xy * dx * dy + prior.w_xt * dx * turn + prior.w_yt * dy * turn)


@njit(cache=True, error_model="numpy")
def _propose(map, num_levels, points, num_points, start, prior, params, max_correction):
    """Match a scan to the map of one particle, from a start, x, y from the map's corner [cells] and heading [rad].

    Returns mode, like the start, `Fit`, log likelihood but for the covariances, hits in known cells and their score,
    and whether the mode fits: it is no farther than `max_correction` from the prior [cells], and hits what is occupied.
    """
    over = (map, num_levels, points, num_points)
    x, y, theta, fit = refine(*over, start, prior, params.iterations, params.coarse_iterations)
    num_known, known_score = known_score_at(map, points, num_points, x, y, theta)
    fits = num_known < params.min_known_hits or known_score >= params.min_known_score
    fits &= distance(x - prior.x, y - prior.y) <= max_correction
    if not fits:
        x, y, theta = prior.x, prior.y, prior.theta
    cost = evaluate(map, 0, points, num_points, x, y, theta).squares + prior_cost(prior, x, y, theta)
    return (x, y, theta), fit, -0.5 * cost / params.residual_variance, num_known, known_score, fits


@njit(cache=True, error_model="numpy")
def propose(maps, poses, motion, start_motion, stds, points, num_points, params, out):
    """Find proposal distribution and importance weight of every particle.

    `poses`: shape (num_particles, 3), float64, at the last key scan, map frame [m, m, rad]; `motion`: since then by
    odometry, as seen from the pose then; `start_motion`: the same, from where the matches start; `stds`: standard
    deviations of odometry's position along either axis [m], and of its heading [rad]; `points`: shape (2, >=
    num_points), float32, hits in the base frame [cells]; `params`: `MatcherParams`, modes farther than `retry_distance`
    from odometry's pose are not believed; `out`: `Proposals`, written.
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
    """Replace proposals by others that fit, and whose hits fall on occupancies greater by `least_gain` in sum."""
    before, after = (each.num_known * each.known_scores for each in (proposals, others))
    is_better = others.fits & (after > before + least_gain)
    for own, other in zip(proposals, others):
        own[is_better] = other[is_better]


def draw_poses(proposals: Proposals, noise: np.ndarray) -> np.ndarray:
    """Draw a pose from each proposal distribution: mode + L z, with L L^T the covariance (Cholesky).

    `noise` is z, shape (num_particles, 3), standard normal; zeros take the mode. Returns poses, shape (num_particles,
    3), float64, map frame [m, m, rad].
    """
    drawn = np.einsum("pij,pj->pi", np.linalg.cholesky(proposals.covariances), noise)
    poses: np.ndarray = proposals.modes + drawn
    poses[:, 2] = (poses[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return poses
