import math

import numpy as np
import pytest

from lidarnaut.envs.estimation.scan_points import ScanGeometry
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.slam import HectorParams, LoopClosureParams
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching import fields
from lidarnaut.envs.slam.matching.fields import Field, HitShares

from ..rooms import LIDAR


def test_hits_next_to_occupied_cells_agree_and_those_on_free_ones_do_not():
    occupancy = np.full((9, 9), -1, dtype=np.int8)
    occupancy[1:7, 1:6] = 0
    occupancy[1:7, 6] = 90
    # On the wall, next to it before and behind, free, unknown, and outside of the map; seen from (1, 4), heading up.
    points = np.array([(0, -5.5), (0, -4.5), (0, -6.5), (1, -2), (3.8, 0), (0, 40)], dtype=np.float32).T
    pose = (1.0, 4.0, 0.5 * math.pi)
    assert fields.count_hits(Field(occupancy, 0.0, 0.0, 1.0), points.T, pose) == (3, 1, 90)
    grid, pose = OccupancyGrid(occupancy, 0.5, (-3.0, 2.0)), (-2.5, 4.0, 0.5 * math.pi)
    assert fields.fits_map(grid, points, pose, 0.5) is None
    many = np.repeat(points, 10, axis=1)
    assert fields.fits_map(grid, many, pose, 0.75) is True
    assert fields.fits_map(grid, many, pose, 0.76) is False


def test_beams_are_asked_for_the_walls_that_they_pass_through():
    occupancy = np.full((40, 40), -1, dtype=np.int8)
    occupancy[:, :30] = 0
    occupancy[:, 20] = 90
    # Four beams from (1, 1): along x to the wall, 0.5 m away, and along y, without a wall.
    angles = np.array([0.0, 0.0, 0.0, 0.5 * math.pi, -0.5 * math.pi])
    geometry = ScanGeometry(np.array([np.cos(angles), np.sin(angles)]), 0.1, 0.0, 3.0, 1.0)
    field, pose = Field(occupancy, 0.0, 0.0, 0.05), (0.45, 1.0, 0.0)
    at_wall, just_behind, through, no_return, ignored = 0.47, 0.7, 0.9, np.inf, np.nan
    for ranges, expected in (
        ([at_wall] * 3 + [0.8, 0.8], (0, 5)),
        ([just_behind, through, through, 0.2, ignored], (2, 3)),  # shorter than the omitted end, ignored
        ([no_return, through, ignored, no_return, 0.8], (2, 3)),  # no return clears its ray, mostly in unknown cells
    ):
        assert fields.count_crossings(field, np.array(ranges, dtype=np.float32), geometry, pose, 0.0) == expected


def test_crossings_equal_those_of_cells_tested_one_by_one():
    """Some beams leave the grid, others pass along its border."""
    rng, geometry, stopped = np.random.default_rng(3), ScanGeometry.of(LIDAR), set()
    field = Field(
        rng.choice([-1, 0, 0, 0, 0, 90], (40, 30), p=[0.1, 0.3, 0.2, 0.2, 0.17, 0.03]).astype(np.int8), -1.0, -1.0, 0.1
    )
    for _ in range(30):
        ranges = rng.uniform(0.2, 4.0, LIDAR.num_beams).astype(np.float32)
        pose = Pose2D(*rng.uniform((-1.2, -1.2), (2.2, 3.2)), rng.uniform(-3, 3))
        eye = pose.compose(Pose2D(geometry.mount_x, geometry.mount_y, 0.0))
        x, y, crossing, judged = (eye.x + 1.0) / 0.1, (eye.y + 1.0) / 0.1, 0, 0
        for r, (u, v) in zip(ranges.tolist(), geometry.directions.T):
            c, s = math.cos(pose.theta), math.sin(pose.theta)
            count, values = math.floor((min(r, LIDAR.range_max) - fields.GRAZING_LENGTH) / 0.1), []
            for step in range(1, count + 1):
                col, row = math.floor(x + step * (c * u - s * v)), math.floor(y + step * (s * u + c * v))
                is_inside = 0 <= row < 40 and 0 <= col < 30
                values.append(int(field.occupancy[row, col]) if is_inside else -1)
            crossing += max(values, default=0) > fields.OCCUPIED_PERCENT
            known = sum(value >= 0 for value in values)
            judged += count > 0 and (2 * known >= count or max(values) > fields.OCCUPIED_PERCENT)
        assert fields.count_crossings(field, ranges, geometry, pose, 0.0) == (crossing, judged)
        for share in (0.05, 0.2, 0.52, 0.9):
            some = fields.count_crossings(field, ranges, geometry, pose, share)
            assert (some[0] > share * some[1]) == (crossing > share * judged)
            stopped.add(some != (crossing, judged))
    assert stopped == {True, False}


def test_a_field_is_what_is_known_of_a_map():
    grid_map = LogOddsMap(HectorParams(map_width=5.0, map_height=5.0, num_levels=1, skip_exceeding=True), LIDAR)
    assert (Field.of(grid_map.grid).occupancy == -1).all()
    ranges = np.full(LIDAR.num_beams, np.inf, dtype=np.float32)
    ranges[90] = 1.0
    grid_map.integrate(ranges, Pose2D(0.5, -0.3, 0.0))
    field = Field.of(grid_map.grid)
    rows, cols = np.nonzero(grid_map.grid.data >= 0)
    assert field.occupancy.shape == (np.ptp(rows) + 1, np.ptp(cols) + 1)
    np.testing.assert_allclose((field.x, field.y), grid_map.grid.centers([[rows.min(), cols.min()]])[0] - 0.025)
    assert field.occupancy.max() == 90


def test_hits_are_counted_by_what_they_fall_on():
    occupancy = np.full((6, 8), -1, dtype=np.int8)
    occupancy[:, :4] = 10
    occupancy[2, 3] = 90
    field = Field(occupancy, 1.0, 2.0, 0.5)
    cells = [(2, 3), (1, 2), (3, 4), (0, 0), (5, 1), (5, 6), (-3, 2), (2, 90)]  # row, column
    points = np.array([[1.0 + 0.5 * (q + 0.5), 2.0 + 0.5 * (r + 0.5)] for r, q in cells])
    pose = Pose2D(0.3, -0.4, 0.8)
    local = np.array([pose.inverse().compose(Pose2D(*point, 0.0))[:2] for point in points], dtype=np.float32)
    shares = fields.hit_shares(field, local, pose)
    # On the wall, twice next to it; two free, one unknown, two outside.
    assert shares == pytest.approx((0.9 / 8, 3 / 8, 2 / 8))
    assert fields.hit_shares(field, local[:0], pose) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("shares", "accepted"),
    [
        (HitShares(0.7, 0.9, 0.05), True),
        (HitShares(0.39, 0.9, 0.05), False),  # misses the walls
        (HitShares(0.6, 0.45, 0.0), False),  # most is unknown
        (HitShares(0.6, 0.8, 0.16), False),  # too many in free space
        (HitShares(0.51, 0.52, 0.14), True),
        (HitShares(0.51, 0.51, 0.15), True),
    ],
)
def test_hits_must_agree_with_what_is_occupied_and_free(shares, accepted):
    assert fields.is_accepted(shares, LoopClosureParams()) is accepted
    assert not fields.is_accepted(shares, LoopClosureParams(min_agreement=0.99)) or shares.free == 0.0
