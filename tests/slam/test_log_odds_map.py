import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import UNKNOWN, Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam import HectorParams
from lidarnaut.envs.slam.log_odds_map import LOG_ODDS_UNIT, MAX_STAMP, STAMP_BITS, LogOddsMap

from .reference import LIDAR, beams, line, random_scan

SMALL = HectorParams(resolution=1.0, map_width=5.0, map_height=5.0, num_levels=1)
ONE_BEAM = LidarParams(num_beams=1, range_max=3.0)
HIT, PASSED = math.log(0.9 / 0.1), math.log(0.4 / 0.6)


def log_odds(words):
    return (words >> STAMP_BITS) / LOG_ODDS_UNIT


def beam(r):
    return np.array([r], dtype=np.float32)


@pytest.mark.parametrize("skip_exceeding", [False, True])
def test_every_level_matches_the_slow_reference(skip_exceeding):
    size = {"resolution": 0.1, "map_width": 1.0, "map_height": 3.0, "num_levels": 3}
    params = HectorParams(**size, skip_exceeding=skip_exceeding, max_log_odds=3.0)
    rng = np.random.default_rng(5)
    grid_map = LogOddsMap(params, LIDAR)
    levels, known = [{}, {}, {}], set()
    for _ in range(6):
        ranges = random_scan(rng)
        pose = Pose2D(*rng.uniform(-0.8, 0.8, 2), rng.uniform(-3, 3))
        update = grid_map.integrate(ranges, pose)
        for k, cells in enumerate(levels):
            observe(cells, beams(ranges, pose, LIDAR, params.resolution * 2**k, skip_exceeding), 3.0)
        rows, cols = (update.new_cells + grid_map.corner[::-1]).T
        new = set(zip(rows.tolist(), cols.tolist()))
        assert not new & known
        known |= new
        assert known == set(levels[0])
    assert grid_map.grid.data.shape > (30, 12)  # the map has grown
    assert grid_map.levels[0] is grid_map.grid.data
    for k, cells in enumerate(levels):
        corner = np.array(grid_map.corner[::-1]) // 2**k
        values = np.full(grid_map.words[k].shape, np.nan)
        for (row, col), value in cells.items():
            values[row - corner[0], col - corner[1]] = value
        np.testing.assert_array_equal(grid_map.levels[k] == UNKNOWN, np.isnan(values))
        is_known = ~np.isnan(values)
        np.testing.assert_allclose(log_odds(grid_map.words[k])[is_known], values[is_known], atol=0.02)
        percent = 100.0 / (1.0 + np.exp(-values[is_known]))
        assert np.abs(grid_map.levels[k][is_known] - percent).max() < 1.0


def observe(cells, scan, bound):
    """Add a scan to log odds by (row, column): once for each cell, hits first."""
    hits, passed = set(), set()
    for first, last, hit, _ in scan:
        passed |= set(line(first, last))
        if hit:
            hits.add(last)
    for cell in hits | passed:
        change = HIT if cell in hits else PASSED
        cells[cell] = min(max(cells.get(cell, 0.0) + change, -bound), bound)


def test_numbers_of_scans_start_again():
    counted, plain = LogOddsMap(SMALL, ONE_BEAM), LogOddsMap(SMALL, ONE_BEAM)
    counted._stamp = MAX_STAMP - 2
    for k in range(6):
        for grid_map in (counted, plain):
            grid_map.integrate(beam(1.0 + k % 2), Pose2D(0.5, 0.5, 0.0))
    np.testing.assert_array_equal(log_odds(counted.words[0]), log_odds(plain.words[0]))
    np.testing.assert_array_equal(counted.grid.data, plain.grid.data)
    assert counted._stamp < 10
