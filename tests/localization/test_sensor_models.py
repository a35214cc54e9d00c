import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.localization import AmclParams
from lidarnaut.envs.localization.beam_model import BeamMixture, BeamModel, beam_likelihood, march
from lidarnaut.envs.localization.likelihood_field import LikelihoodField, obstacle_distances
from lidarnaut.envs.robots import LidarParams, Mount

LIDAR = LidarParams(37, 3.0, fov=math.pi, mount=Mount(x=0.1, y=-0.05, yaw=0.2))


def _room(rng, height=50, width=70, share=0.03):
    data = np.where(rng.random((height, width)) < share, 100, 0).astype(np.int8)
    data[rng.random((height, width)) < 0.05] = -1
    return OccupancyGrid(data, 0.05, (-1.3, 2.1))


def _cloud(rng, grid, count):
    x_min, y_min, x_max, y_max = grid.bounds
    low, high = (x_min - 0.3, y_min - 0.3, -math.pi), (x_max + 0.3, y_max + 0.3, math.pi)
    return np.ascontiguousarray(rng.uniform(low, high, (count, 3)).T.astype(np.float32))


def _scan(rng):
    ranges = rng.uniform(0.1, 2.9, LIDAR.num_beams).astype(np.float32)
    ranges[4], ranges[10] = np.inf, np.nan
    return ranges


def _field_reference(params, grid, ranges, particles):
    occupied = grid.centers(np.argwhere(grid.data >= 65))
    x_min, y_min, x_max, y_max = grid.bounds
    weights = []
    for x, y, theta in particles.T.astype(float):
        total = 0.0
        for reading, angle in zip(ranges, LIDAR.angles + LIDAR.mount.yaw):
            if not np.isfinite(reading):
                continue
            point = np.array([[LIDAR.mount.x + reading * math.cos(angle), LIDAR.mount.y + reading * math.sin(angle)]])
            end = Pose2D(x, y, theta).transform(point)
            center = grid.centers(grid.cells(end))
            distance = min(float(np.hypot(*(occupied - center).T).min()), params.max_distance)
            if not (x_min <= x < x_max and y_min <= y < y_max):
                distance = params.max_distance
            pz = params.z_hit * math.exp(-(distance**2) / (2 * params.sigma_hit**2)) + params.z_rand / LIDAR.range_max
            total += math.log(pz) if params.sensor == "likelihood_field_prob" else pz**3
        weights.append(math.exp(total / params.squash) if params.sensor == "likelihood_field_prob" else 1.0 + total)
    return np.array(weights)


@pytest.mark.parametrize(("sensor", "squash"), [("likelihood_field", 1), ("likelihood_field_prob", 3)])
def test_likelihood_fields_equal_their_formulas(sensor, squash):
    rng = np.random.default_rng(2)
    grid, ranges = _room(rng), _scan(rng)
    params = AmclParams(sensor=sensor, squash=squash, max_distance=0.6, alpha_slow=0.1, alpha_fast=0.2)
    particles = _cloud(rng, grid, 200)
    prior = rng.random(200)
    weights = prior.copy()
    level = LikelihoodField(params, LIDAR, grid)(ranges)(particles, weights)
    expected = _field_reference(params, grid, ranges, particles)
    ratio = weights / prior / expected
    # Single precision occasionally puts a beam into the next cell.
    same = np.abs(ratio / np.median(ratio) - 1.0) < 2e-3
    assert same.mean() > 0.9
    if sensor == "likelihood_field":
        np.testing.assert_allclose(np.median(ratio), 1.0, rtol=1e-3)
        assert level == pytest.approx((prior * expected).sum(), rel=0.01)
    else:
        hits = np.isfinite(ranges).sum()
        assert level == pytest.approx((prior * expected ** (squash / hits)).sum(), rel=0.01)


def test_distances_without_obstacles_are_the_greatest():
    np.testing.assert_array_equal(obstacle_distances(np.zeros((3, 4), dtype=bool), 0.1, 0.7), 0.7)


def test_beams_are_spread_evenly_and_useless_ones_left_out():
    lidar = LidarParams(360, 3.5)
    grid = OccupancyGrid(np.zeros((10, 10), dtype=np.int8), 0.05, (0.0, 0.0))
    field = LikelihoodField(AmclParams(max_beams=60), lidar, grid)
    ranges = np.full(360, 2.0, dtype=np.float32)
    assert field.beams.hits(ranges)[1] == 60
    ranges[::12] = np.inf
    ranges[6::24] = np.nan
    assert field.beams.hits(ranges)[1] == 15
    assert field(np.full(360, np.nan, dtype=np.float32)) is None
    assert LikelihoodField(AmclParams(max_beams=500), lidar, grid).beams.hits(ranges)[1] == 315
    assert LikelihoodField(AmclParams(max_beams=60, max_range=1.5), lidar, grid).beams.hits(ranges)[1] == 0


def test_fit_counts_hits_near_obstacles():
    data = np.zeros((40, 40), dtype=np.int8)
    data[:, 30] = 100
    grid = OccupancyGrid(data, 0.1, (0.0, 0.0))
    lidar = LidarParams(5, 5.0, fov=0.4)
    field = LikelihoodField(AmclParams(max_beams=5, lost_distance=0.2), lidar, grid)
    ranges = np.array([2.0, 2.0, 2.0, np.nan, np.inf], dtype=np.float32)
    assert field.fit(ranges, Pose2D(1.05, 2.0, 0.0)) == (1.0, 3)
    assert field.fit(ranges, Pose2D(1.55, 2.0, 0.0)) == (0.0, 3)
    assert field.fit(ranges, Pose2D(-30.0, 2.0, 0.0)) == (0.0, 3)


def test_rays_end_where_the_finest_walk_ends():
    rng = np.random.default_rng(6)
    blocked = rng.random((60, 80)) < 0.01
    distances = (obstacle_distances(blocked, 1.0, 40.0)).astype(np.float32)
    worst = []
    for _ in range(500):
        x, y, angle = rng.uniform(0, 80), rng.uniform(0, 60), rng.uniform(-math.pi, math.pi)
        dx, dy = math.cos(angle), math.sin(angle)
        found = march(distances, *map(np.float32, (x, y, dx, dy, 50.0)))
        travelled = 0.0
        while travelled < 50.0:
            col, row = math.floor(x + travelled * dx), math.floor(y + travelled * dy)
            if not (0 <= col < 80 and 0 <= row < 60):
                travelled = 50.0
            elif blocked[row, col]:
                break
            else:
                travelled += 0.01
        worst.append(abs(found - min(travelled, 50.0)))
    # Obstacles that overlap the ray by less than half a cell may be missed; here they are single cells.
    assert np.mean(np.array(worst) < 0.55) > 0.93


def test_mixture_by_hand():
    mixture = BeamMixture(z_hit=0.5, z_short=0.05, z_max=0.05, z_rand=0.5, sigma_hit=0.2, lambda_short=0.1)
    at_wall = beam_likelihood(2.0, 2.0, 10.0, mixture)
    assert at_wall == pytest.approx(0.5 + 0.05)
    before = beam_likelihood(1.0, 2.0, 10.0, mixture)
    assert before == pytest.approx(0.5 * math.exp(-12.5) + 0.05 * 0.1 * math.exp(-0.1) + 0.05)
    assert beam_likelihood(10.0, 10.0, 10.0, mixture) == pytest.approx(0.5 + 0.05)


def test_beam_model_weighs_what_it_casts():
    data = np.zeros((40, 60), dtype=np.int8)
    data[:, 50] = 100
    grid = OccupancyGrid(data, 0.05, (0.0, 0.0))
    lidar = LidarParams(3, 3.0, fov=0.2)
    params = AmclParams(sensor="beam", max_beams=3)
    particles = np.array([[1.025, 1.0, 0.0], [0.525, 1.0, 0.0]], dtype=np.float32).T.copy()
    weights = np.ones(2)
    ranges = np.array([np.nan, 1.5, np.inf], dtype=np.float32)
    BeamModel(params, lidar, grid)(ranges)(particles, weights)

    def factor(expected):
        mixture = BeamMixture(0.5, 0.05, 0.05, 0.5, 0.2, 0.1)
        hit = beam_likelihood(1.5, expected, 3.0, mixture)
        slanted = beam_likelihood(3.0, expected / math.cos(0.1), 3.0, mixture)
        return 1.0 + hit**3 + slanted**3

    np.testing.assert_allclose(weights, [factor(1.475), factor(1.975)], rtol=0.03)
    assert BeamModel(params, lidar, grid)(np.full(3, np.nan, dtype=np.float32)) is None


def test_unknown_cells_stop_rays_but_are_no_obstacles():
    data = np.zeros((40, 60), dtype=np.int8)
    data[:, 50:] = -1
    grid, lidar = OccupancyGrid(data, 0.05, (0.0, 0.0)), LidarParams(1, 3.0, fov=0.2)
    particles = np.array([[1.025, 1.0, 0.0], [0.425, 1.0, 0.0]], dtype=np.float32).T.copy()
    beam, field = np.ones(2), np.ones(2)
    for model, weights in ((BeamModel, beam), (LikelihoodField, field)):
        model(AmclParams(max_beams=1), lidar, grid)(np.array([1.5], dtype=np.float32))(particles, weights)
    assert beam[0] > beam[1]
    assert field[0] == field[1]
