import numpy as np
import pytest

from lidarnaut.envs.geometry import UNKNOWN, Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam import GMappingParams, HectorParams
from lidarnaut.envs.slam.gmapping.particle_maps import ParticleMaps
from lidarnaut.envs.slam.gmapping.tiles import make_pool
from lidarnaut.envs.slam.log_odds_map import MAX_STAMP, LogOddsMap
from tests.slam.reference import LIDAR, random_scan

SHARED = {"resolution": 0.05, "map_width": 3.0, "map_height": 3.0, "num_levels": 3, "max_log_odds": 5.0}


def cut(occupancy, corner, level):
    """Return known cells by (row, column) from the map frame's origin."""
    rows, cols = np.nonzero(occupancy != UNKNOWN)
    values = occupancy[rows, cols].tolist()
    keys = zip((rows + corner[1] // 2**level).tolist(), (cols + corner[0] // 2**level).tolist())
    return dict(zip(keys, values))


@pytest.mark.parametrize("skip_exceeding", [False, True])
def test_maps_that_share_tiles_equal_maps_that_are_copied(skip_exceeding):
    rng, count = np.random.default_rng(5), 4
    params = GMappingParams(num_particles=count, skip_exceeding=skip_exceeding, **SHARED)
    ours = ParticleMaps(params, LIDAR)

    def replayed(scans):
        plain = LogOddsMap(HectorParams(skip_exceeding=skip_exceeding, **SHARED), LIDAR)
        for ranges, pose in scans:
            plain.integrate(ranges, pose)
        return plain

    scans = [[] for _ in range(count)]
    for k in range(12):
        ranges, is_integrated = random_scan(rng), rng.random(count) < 0.8
        poses = rng.uniform(-0.8, 0.8, (count, 3)) * (1.0 + 0.4 * k, 1.0, 4.0)
        ours.integrate(ranges, poses, is_integrated)
        for p in np.flatnonzero(is_integrated).tolist():
            scans[p].append((ranges, Pose2D(*poses[p].tolist())))
        if k % 3 == 2:
            parents = np.sort(rng.integers(0, count, count))
            ours.resample(parents)
            scans = [list(scans[p]) for p in parents.tolist()]
        for p in range(count):
            plain = replayed(scans[p])
            for level in range(3):
                expected = cut(plain.levels[level], plain.corner, level)
                assert cut(ours.occupancy(p, level), ours.corner, level) == expected
    assert ours.grid.data.shape[1] > 64  # the map has grown


def test_the_grid_follows_the_particle_that_is_rendered():
    rng, count = np.random.default_rng(8), 3
    ours = ParticleMaps(GMappingParams(num_particles=count, **SHARED), LIDAR)
    grid, shown, num_changed = ours.grid, 0, 0
    for k in range(30):
        poses = rng.uniform(-0.8, 0.8, (count, 3)) + (0.1 * k, 0.0, 0.0)
        ours.integrate(random_scan(rng), poses, rng.random(count) < 0.7)
        if k % 4 == 3:
            ours.resample(parents := np.sort(rng.integers(0, count, count)))
            copies = np.flatnonzero(parents == shown)
            particle, is_switched = (int(copies[0]), False) if len(copies) else (0, True)
        else:
            particle = int(rng.integers(count)) if k % 5 == 4 else shown
            is_switched = particle != shown
        before = cut(grid.data, ours.corner, 0)
        update, shown = ours.render(particle, is_switched), particle
        assert ours.grid is grid
        np.testing.assert_array_equal(grid.data, ours.occupancy(particle))
        after = cut(grid.data, ours.corner, 0)
        new = set(map(tuple, (update.new_cells + ours.corner[::-1]).tolist()))
        assert update.redrawn == is_switched
        assert new == (after.keys() if is_switched else after.keys() - before.keys())
        if not is_switched and update.window is not None:
            rows, cols = (range(part.start, part.stop) for part in update.window.slices)
            for row, col in (cell for cell in after if after[cell] != before.get(cell)):
                assert row - ours.corner[1] in rows
                assert col - ours.corner[0] in cols
            named = set(map(tuple, (update.changed_cells + ours.corner[::-1]).tolist()))
            assert named == {cell for cell in before if (before[cell] >= 50) != (after[cell] >= 50)}
            num_changed += len(named)
    assert num_changed > 10


def test_a_scan_for_which_the_pool_is_enlarged_midway_is_integrated_once():
    lidar = LidarParams(num_beams=60, range_max=30.0)
    params = GMappingParams(num_particles=2, map_width=70.0, map_height=70.0, num_levels=2)
    small, large = ParticleMaps(params, lidar), ParticleMaps(params, lidar)
    small._pool, large._pool = make_pool(5, 2), make_pool(4096, 2)
    poses, rng = np.array([[0.0, 0.0, 0.0], [0.5, 0.2, 1.0]]), np.random.default_rng(0)
    for _ in range(2):
        ranges = rng.uniform(5.0, 31.0, 60).astype(np.float32)
        for maps in (small, large):
            maps.integrate(ranges, poses, np.ones(2, dtype=np.bool_))
    assert len(small._pool.words) > 100
    for p in range(2):
        for level in range(2):
            np.testing.assert_array_equal(small.occupancy(p, level), large.occupancy(p, level))


def test_numbers_of_scans_start_again():
    counted, plain = (ParticleMaps(GMappingParams(num_particles=2, **SHARED), LIDAR) for _ in range(2))
    counted._stamp = MAX_STAMP - 2
    rng = np.random.default_rng(1)
    for _ in range(6):
        ranges, poses = random_scan(rng), rng.uniform(-0.5, 0.5, (2, 3))
        for maps in (counted, plain):
            maps.integrate(ranges, poses, np.ones(2, dtype=np.bool_))
    np.testing.assert_array_equal(counted.occupancy(1), plain.occupancy(1))
    assert counted._stamp < 10
