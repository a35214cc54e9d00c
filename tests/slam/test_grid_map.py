import dataclasses
import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import UNKNOWN, Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam import HectorParams, TinySlamParams
from lidarnaut.envs.slam.grid_map import COUNT_BITS, FULL_OCCUPANCY, MAX_COUNT, GridMap, observe
from lidarnaut.envs.slam.growing_map import MAX_CELLS
from lidarnaut.envs.slam.log_odds_map import LogOddsMap

from .reference import LIDAR, ReferenceMap, check_changed_cells, random_scan

SMALL = TinySlamParams(resolution=1.0, map_width=5.0, map_height=5.0, hole_width=0.0, quality=1.0, unvisited=0.5)
ONE_BEAM = LidarParams(num_beams=1, range_max=3.0)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"blur": "add", "hole_width": 0.31, "occupied_prob": 0.99, "empty_prob": 0.2},
        {"quality": 0.3, "skip_exceeding": True},
        {"hole_width": 0.0},
        {"occupancy_estimator": "area"},
        {"cell_type": "base", "quality": 0.2},
        {"occupancy_estimator": "area", "cell_type": "base", "blur": "add", "empty_prob": 0.2, "hole_width": 0.31},
    ],
    ids=str,
)
def test_map_matches_the_slow_reference(changes):
    usual = {"resolution": 0.1, "map_width": 1.0, "map_height": 3.0, "hole_width": 0.25, "blur": "assign"}
    params = TinySlamParams(**usual | changes)
    rng = np.random.default_rng(5)
    grid_map, reference = GridMap(params, LIDAR), ReferenceMap(params, LIDAR)
    known = set()
    for _ in range(6):
        ranges = random_scan(rng)
        pose = Pose2D(*rng.uniform(-0.8, 0.8, 2), rng.uniform(-3, 3))
        update = grid_map.integrate(ranges, pose, params.quality)
        new, window = update[:2]
        assert (new >= window[:2]).all()
        assert (new < np.add(window[:2], window[2:])).all()
        reference.draw(ranges, pose, params.quality)
        corner = np.round(np.array(grid_map.grid.origin) / params.resolution).astype(int)
        new = {(row + corner[1], col + corner[0]) for row, col in new.tolist()}
        assert not new & known
        known |= new
        assert known == set(reference.cells)
    assert grid_map.words.shape > (30, 10)  # the map has grown
    rows, cols = (np.array(list(reference.cells)) - corner[::-1]).T
    values = (grid_map.words >> COUNT_BITS) / FULL_OCCUPANCY
    np.testing.assert_allclose(values[rows, cols], [value for value, _ in reference.cells.values()], atol=2e-4)
    np.testing.assert_array_equal((grid_map.words & MAX_COUNT)[rows, cols], [n for _, n in reference.cells.values()])
    percent = np.full(values.shape, UNKNOWN)
    percent[rows, cols] = np.floor(100.0 * values[rows, cols] + 0.5)
    np.testing.assert_array_equal(grid_map.grid.data, percent)


@pytest.mark.parametrize("changes", [None, {}, {"occupancy_estimator": "area"}, {"cell_type": "base"}], ids=str)
def test_an_update_names_the_known_cells_that_became_occupied_or_free(changes):
    rng, num_changed, quality = np.random.default_rng(5), 0, () if changes is None else (0.5,)
    if changes is None:
        grid_map = LogOddsMap(HectorParams(resolution=0.1), LIDAR)
    else:
        grid_map = GridMap(TinySlamParams(resolution=0.1, **changes), LIDAR)
    for _ in range(8):
        num_changed += check_changed_cells(grid_map, random_scan(rng), Pose2D(0.1, 0.0, rng.uniform(-3, 3)), *quality)
    assert num_changed > 5


def test_counting_saturates_and_the_mean_stays_within_its_grain():
    target = round(0.7 * FULL_OCCUPANCY)
    word = observe(0, round(0.1 * FULL_OCCUPANCY))
    for _ in range(2 * MAX_COUNT):
        word = observe(word, target)
    assert word & MAX_COUNT == MAX_COUNT
    assert (word >> 12) / FULL_OCCUPANCY == pytest.approx(0.7, abs=5e-3)


def test_a_cell_that_every_beam_passes_counts_up_to_the_maximum():
    lidar = LidarParams(num_beams=600, range_max=3.0)
    grid_map = GridMap(dataclasses.replace(SMALL, resolution=0.5, empty_prob=0.2), lidar)
    for count in (600, 1200, 1800, 2400, 3000, 3600, MAX_COUNT, MAX_COUNT):
        grid_map.integrate(np.full(600, 2.0, dtype=np.float32), Pose2D(0.0, 0.0, 0.0), 1.0)
        word = grid_map.words[-grid_map.corner[1], -grid_map.corner[0]]
        assert (word & MAX_COUNT, word >> 12) == (count, round(0.2 * FULL_OCCUPANCY))


def test_growth_by_powers_of_two_keeps_what_is_known_in_place():
    grid_map, known = GridMap(SMALL, dataclasses.replace(ONE_BEAM, range_max=100.0)), np.empty((0, 2))
    grid = grid_map.grid
    for reach, heading, shape, origin in (
        (2.0, 0.0, (5, 5), (-2.0, -2.0)),
        (11.0, math.pi, (5, 20), (-17.0, -2.0)),  # column 2 - 11 = -9 needs 4 times 5 columns, all new ones on the left
        (4.0, -math.pi / 2, (10, 20), (-17.0, -7.0)),
        (4.0, math.pi / 2, (20, 20), (-17.0, -7.0)),
    ):
        new, *_ = grid_map.integrate(np.array([reach], dtype=np.float32), Pose2D(0.5, 0.5, heading), 1.0)
        assert (grid.data.shape, grid.origin) == (shape, origin)
        known = np.concatenate([known, grid.centers(new)])
        assert set(map(tuple, known)) == set(map(tuple, grid.centers(np.argwhere(grid.data != UNKNOWN))))
    assert grid is grid_map.grid


def test_a_map_that_grows_without_bound_is_an_error():
    grid_map = GridMap(SMALL, ONE_BEAM)
    with pytest.raises(MemoryError, match="diverged"):
        grid_map.integrate(np.array([2.0], dtype=np.float32), Pose2D(float(MAX_CELLS), 0.0, 0.0), 1.0)
