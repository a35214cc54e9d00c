import math

import numpy as np

from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.slam import GMappingParams, HectorParams
from lidarnaut.envs.slam.gmapping.gmapping import normalized_weights, spread, systematic_resample
from lidarnaut.envs.slam.gmapping.particle_maps import ParticleMaps
from lidarnaut.envs.slam.gmapping.proposal import Proposals, draw_poses, propose
from lidarnaut.envs.slam.gmapping.tiles import TileMap
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.gauss_newton import PosePrior, evaluate, known_score_at, refine
from lidarnaut.envs.slam.matching.scan_matcher import MatcherParams
from tests.slam.rooms import LIDAR, scan

SIZE = {"map_width": 16.0, "map_height": 16.0, "num_levels": 3}
POSES = [Pose2D(0.0, 0.0, 0.0), Pose2D(0.2, 0.1, 0.3), Pose2D(-0.3, 0.2, -0.5)]


def make_maps(count=2):
    rng = np.random.default_rng(4)
    tiles = ParticleMaps(GMappingParams(num_particles=count, **SIZE), LIDAR)
    plain = LogOddsMap(HectorParams(**SIZE), LIDAR)
    for pose in POSES:
        ranges = scan(pose, rng)
        tiles.integrate(ranges, np.tile(np.array(pose), (count, 1)), np.ones(count, dtype=np.bool_))
        plain.integrate(ranges, pose)
    return tiles, plain


def tile_map(tiles, particle=0):
    pool, slots, wide, *_ = tiles.maps
    return TileMap(pool.occupancy.ravel(), pool.occupancy.shape[1], slots[particle], wide)


def hits(pose, tiles):
    points = np.empty((2, LIDAR.num_beams), dtype=np.float32)
    return points, project_hits(scan(pose), tiles.geometry, points)


def test_fit_and_match_equal_those_on_one_array():
    tiles, plain = make_maps()
    points, count = hits(POSES[1], tiles)
    apart = np.subtract(tiles.corner, plain.corner)
    prior = (0.5, 0.1, 0.02, 0.4, 0.03, 60.0)
    for x, y, theta in [(0.2, 0.1, 0.3), (0.33, -0.04, 0.2), (6.5, 0.0, 1.0), (-30.0, 2.0, 0.0)]:
        at = np.array(plain.to_cells(x, y))
        for level in range(3):
            ours = evaluate(tile_map(tiles), level, points, count, *(at - apart), theta)
            np.testing.assert_allclose(ours, evaluate(plain.levels, level, points, count, *at, theta), rtol=1e-9)
        ours = known_score_at(tile_map(tiles), points, count, *(at - apart), theta)
        np.testing.assert_allclose(ours, known_score_at(plain.levels, points, count, *at, theta), rtol=1e-12)
        start = (*(at - apart), theta)
        ours = refine(tile_map(tiles), 3, points, count, start, PosePrior(*start, *prior), 6, 4)
        theirs = refine(plain.levels, 3, points, count, (*at, theta), PosePrior(*at, theta, *prior), 6, 4)
        np.testing.assert_allclose(np.add(ours[:2], apart), theirs[:2], atol=1e-6)
        np.testing.assert_allclose(ours[2], theirs[2], atol=1e-9)


def test_known_score_by_hand():
    tiles, _ = make_maps()
    points, count = hits(POSES[1], tiles)
    x, y = tiles.to_cells(0.2, 0.1)
    occupancy = tiles.occupancy(0).astype(float)
    c, s = math.cos(0.3), math.sin(0.3)
    p_x, p_y = points.astype(float)
    u, v = c * p_x - s * p_y + x, s * p_x + c * p_y + y
    values = occupancy[v[:count].astype(int), u[:count].astype(int)]
    expected = np.count_nonzero(values >= 0), 0.01 * values[values >= 0].mean()
    np.testing.assert_allclose(known_score_at(tile_map(tiles), points, count, x, y, 0.3), expected)


def test_mode_covariance_and_weight_are_those_of_the_posterior():
    """Compared with the posterior summed over a grid of poses (Grisetti et al., 2007, equations 14 to 19)."""
    tiles, _ = make_maps(1)
    points, count = hits(POSES[1], tiles)
    k, stds = 1.0, (0.02, 0.02, 0.02)
    params = MatcherParams.of(GMappingParams(residual_variance=k, iterations=20, coarse_iterations=5))
    by_odometry, out = Pose2D(0.21, 0.09, 0.31), Proposals.make(1)
    prior = tuple(by_odometry)
    propose(tiles.maps, np.zeros((1, 3)), prior, prior, (0.02, 0.02), points, count, params, out)
    steps = np.linspace(-0.02, 0.02, 11)
    offsets = np.stack(np.meshgrid(steps, steps, 0.4 * steps, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = out.modes[0] + offsets
    logs = np.empty(len(poses))
    for n, (x, y, theta) in enumerate(poses):
        squares = evaluate(tile_map(tiles), 0, points, count, *tiles.to_cells(x, y), theta).squares
        logs[n] = -0.5 * squares / k - 0.5 * np.square((poses[n] - by_odometry) / stds).sum()
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ poses
    sampled = np.sqrt(weights @ np.square(poses - mean))
    assert out.fits[0]
    np.testing.assert_allclose(out.modes[0], mean, atol=0.003)
    np.testing.assert_allclose(np.sqrt(np.diag(out.covariances[0])), sampled, rtol=0.5)
    cell = (steps[1] - steps[0]) ** 3 * 0.4
    integral = logs.max() + math.log(np.exp(logs - logs.max()).sum() * cell / ((2 * math.pi) ** 1.5 * np.prod(stds)))
    assert abs(out.log_likelihoods[0] - integral) < 1.0


def test_a_scan_that_fits_nothing_leaves_the_motion_model():
    tiles, _ = make_maps(1)
    points = np.zeros((2, 60), dtype=np.float32)
    points[0] = 8.0
    params = MatcherParams.of(GMappingParams())
    out, motion = Proposals.make(1), Pose2D(0.2, 0.1, 0.3)
    propose(tiles.maps, np.zeros((1, 3)), tuple(motion), tuple(motion), (0.001, 0.002), points, 60, params, out)
    assert not out.fits[0]
    np.testing.assert_allclose(out.modes[0], motion, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(out.covariances[0])), [0.001, 0.001, 0.002])
    squares = evaluate(tile_map(tiles), 0, points, 60, *tiles.to_cells(0.2, 0.1), 0.3).squares
    np.testing.assert_allclose(out.log_likelihoods[0], -squares)  # 2 k = 1


def test_poses_are_drawn_with_the_covariance():
    rng, count = np.random.default_rng(0), 20000
    proposals, root = Proposals.make(count), rng.normal(size=(3, 3)) * 0.1
    proposals.modes[:], proposals.covariances[:] = (1.0, 2.0, 0.3), root @ root.T
    poses = draw_poses(proposals, rng.standard_normal((count, 3)))
    np.testing.assert_allclose(poses.mean(axis=0), (1.0, 2.0, 0.3), atol=0.01)
    np.testing.assert_allclose(np.cov(poses.T), root @ root.T, atol=0.002)
    np.testing.assert_allclose(draw_poses(proposals, np.zeros((count, 3))), proposals.modes, rtol=1e-14)


def test_weights_from_logarithms_far_below_zero():
    weights = normalized_weights(np.log([1.0, 2.0, 5.0]) - 4000.0)
    np.testing.assert_allclose(weights, [0.125, 0.25, 0.625])


def test_each_particle_is_chosen_as_often_as_its_weight_says():
    rng, counts = np.random.default_rng(0), np.zeros(12)
    weights = rng.dirichlet(np.full(12, 0.5))
    for _ in range(4000):
        chosen = np.bincount(systematic_resample(weights, rng.random()), minlength=12)
        assert (np.abs(chosen - 12 * weights) < 1.0).all()
        counts += chosen
    np.testing.assert_allclose(counts / 4000, 12 * weights, atol=0.05)


def test_spread_by_hand_and_across_half_a_turn():
    poses = np.array([[1.0, 0.0, math.pi - 0.1], [3.0, 0.0, -math.pi + 0.1]])
    covariance = spread(poses, np.array([0.5, 0.5]), poses[0])
    np.testing.assert_allclose(covariance, [[1.0, 0.0, 0.1], [0.0, 0.0, 0.0], [0.1, 0.0, 0.01]], atol=1e-12)
