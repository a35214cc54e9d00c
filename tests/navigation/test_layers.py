"""The layered costmap: scans mark and clear, inflation follows, and the known map stays."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation import CostmapParams, LayeredCostmap, ObstacleParams, make_costmap
from envs.robots import LidarParams
from tests.navigation.costs import cost_at

LIDAR = LidarParams(num_beams=360, range_max=3.5)
PARAMS = CostmapParams(robot_radius=0.2, inflation_radius=0.5)
MIDDLE = Pose2D(0.0, 0.0, 0.0)


def room(known=True):
    """A room of 6 m x 6 m around the origin, which is the middle of a cell."""
    data = np.full((125, 125), 0 if known else -1, dtype=np.int8)
    data[[0, 1, -2, -1]] = 100
    data[:, [0, 1, -2, -1]] = 100
    return OccupancyGrid(data, 0.05, (-3.125, -3.125))


def scan_of(beams, distance, elsewhere=np.inf):
    ranges = np.full(360, elsewhere, dtype=np.float32)
    ranges[beams] = distance
    return ranges


def beam_at(degrees):
    """Index of the beam in a direction; the first one looks backwards."""
    return (degrees + 180) % 360


def test_hits_mark_and_inflate_and_later_beams_clear():
    layers = LayeredCostmap(room(), PARAMS)
    before = layers.costmap.costs.copy()
    layers.update(MIDDLE, scan_of(beam_at(90), 1.02), LIDAR)
    assert layers.num_marked == 1
    assert cost_at(layers.costmap, 0.01, 1.02) == 254
    assert cost_at(layers.costmap, 0.01, 1.17) == 253
    assert 0 < cost_at(layers.costmap, 0.01, 1.4) < 253
    # The same obstacle has gone: the beam passes through.
    layers.update(MIDDLE, scan_of(beam_at(90), 2.0), LIDAR)
    assert cost_at(layers.costmap, 0.01, 1.02) < 253
    assert cost_at(layers.costmap, 0.01, 2.0) == 254
    layers.update(MIDDLE, scan_of(beam_at(90), np.inf), LIDAR)
    np.testing.assert_array_equal(layers.costmap.costs, before)


def test_far_hits_do_not_mark_but_clear():
    layers = LayeredCostmap(room(), PARAMS)
    layers.update(MIDDLE, scan_of(beam_at(0), 2.0), LIDAR)
    layers.update(MIDDLE, scan_of(beam_at(0), 2.6), LIDAR)
    assert layers.num_marked == 0


def test_nan_beams_say_nothing():
    layers = LayeredCostmap(room(), PARAMS)
    layers.update(MIDDLE, scan_of(beam_at(0), 1.0), LIDAR)
    costs = layers.costmap.costs.copy()
    layers.update(MIDDLE, np.full(360, np.nan, dtype=np.float32), LIDAR)
    np.testing.assert_array_equal(layers.costmap.costs, costs)


def test_hits_near_a_wall_of_the_map_are_that_wall():
    layers = LayeredCostmap(room(), PARAMS, ObstacleParams(marking_range=4.0, clearing_range=4.0))
    # The wall is 3 m away; a pose that is wrong by 0.1 m sees it in front of where it is.
    layers.update(MIDDLE, scan_of(beam_at(0), 2.9), LIDAR)
    assert layers.num_marked == 0
    layers.update(MIDDLE, scan_of(beam_at(0), 2.7), LIDAR)
    assert layers.num_marked == 1


def test_beams_never_clear_the_map():
    layers = LayeredCostmap(room(), PARAMS, ObstacleParams(clearing_range=3.5))
    before = layers.costmap.costs.copy()
    layers.update(MIDDLE, scan_of(beam_at(0), np.inf), LIDAR)
    np.testing.assert_array_equal(layers.costmap.costs, before)


def test_unknown_space_becomes_known_where_beams_pass():
    layers = LayeredCostmap(room(known=False), PARAMS)
    assert cost_at(layers.costmap, 1.0, 0.01) == 255
    layers.update(MIDDLE, scan_of(beam_at(0), 2.0, elsewhere=np.nan), LIDAR)
    assert cost_at(layers.costmap, 1.0, 0.01) == 0
    assert cost_at(layers.costmap, 1.99, 0.01) == 254
    assert cost_at(layers.costmap, 0.0, 1.0) == 255


def test_the_mount_of_the_lidar_counts():
    mounted = dataclasses.replace(LIDAR, mount=dataclasses.replace(LIDAR.mount, x=0.5, yaw=np.pi / 2))
    layers = LayeredCostmap(room(), PARAMS)
    layers.update(Pose2D(0.0, 0.0, np.pi), scan_of(beam_at(0), 1.02), mounted)
    assert cost_at(layers.costmap, -0.5, -1.02) == 254


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_costs_equal_those_of_the_whole_map_inflated_anew(seed):
    rng = np.random.default_rng(seed)
    layers = LayeredCostmap(room(known=bool(rng.integers(2))), PARAMS)
    for _ in range(5):
        pose = Pose2D(*rng.uniform(-3.5, 3.5, 2), rng.uniform(-3, 3))
        ranges = rng.choice([np.nan, np.inf, 0.5, 1.5, 2.5, 3.4], 360).astype(np.float32)
        layers.update(pose, ranges, LIDAR)
        if rng.random() < 0.3:
            layers.mark(rng.uniform(-4.0, 4.0, (3, 2)))
        if rng.random() < 0.3:
            layers.clear_around(*rng.uniform(-4.0, 4.0, 2), 0.7)
        if rng.random() < 0.5:
            continue
        found = layers.costmap
        np.testing.assert_array_equal(found.costs, make_costmap(found.grid, PARAMS).costs)
    np.testing.assert_array_equal(layers.costmap.costs, make_costmap(layers.costmap.grid, PARAMS).costs)


def test_clearing_forgets_what_scans_found():
    layers = LayeredCostmap(room(), PARAMS)
    before = layers.costmap.costs.copy()
    layers.update(MIDDLE, scan_of([beam_at(0), beam_at(180)], 1.0), LIDAR)
    layers.clear_around(1.0, 0.0, 0.2)
    assert layers.num_marked == 1
    assert cost_at(layers.costmap, -0.99, 0.01) == 254
    layers.clear()
    np.testing.assert_array_equal(layers.costmap.costs, before)


def test_bad_input_is_named():
    layers = LayeredCostmap(room(), PARAMS)
    with pytest.raises(ValueError, match="pose must be finite"):
        layers.update(Pose2D(np.nan, 0.0, 0.0), scan_of(0, 1.0), LIDAR)
    with pytest.raises(ValueError, match=r"ranges must have shape \(360,\)"):
        layers.update(MIDDLE, np.ones(12, dtype=np.float32), LIDAR)
    with pytest.raises(ValueError, match="marking_range"):
        ObstacleParams(marking_range=0.0)
    with pytest.raises(ValueError, match="same_obstacle"):
        ObstacleParams(same_obstacle=-1.0)
