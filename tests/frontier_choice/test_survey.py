"""What a survey finds: on maps drawn by hand, and against the slow way."""

import math

import numpy as np
import pytest

from envs.frontier_choice.candidates import (
    COST,
    FRONTIER_COL,
    FRONTIER_ROW,
    GAIN,
    GOAL_COL,
    GOAL_ROW,
    find_candidates,
)
from envs.frontier_choice.features import FEATURES, describe
from envs.frontier_choice.nearby import frontier_in_sight, frontier_near
from envs.frontier_choice.params import SurveyParams
from envs.frontier_choice.survey import join_cells, write_path
from envs.frontier_choice.tables import tables_of
from envs.geometry import OccupancyGrid
from envs.navigation import CostmapParams, frontier_mask, make_costmap, travel_field
from envs.robots import load_robot

BURGER = load_robot("turtlebot3_burger")
TABLES = tables_of(SurveyParams(), BURGER, 0.05)
NOTHING = np.empty((0, 2))


def room(width=4.0, height=2.0, *, doors=()):
    """A room with its corner at the origin, known and free inside walls; beyond the doors (x0, x1) above, free cells
    of a strip that borders on the unknown."""
    data = np.full((round(height / 0.05) + 20, round(width / 0.05)), -1, dtype=np.int8)
    rows = round(height / 0.05)
    data[:rows] = 0
    data[:2] = data[rows - 2 : rows] = 100
    data[:rows, :2] = data[:rows, -2:] = 100
    for x0, x1 in doors:
        data[rows - 2 : rows + 4, round(x0 / 0.05) : round(x1 / 0.05)] = 0
    return data


def candidates(data, x, y, *, given_up=NOTHING, lengths=(4, 2), most=24, tables=TABLES[0]):
    return find_candidates(data, 0.05, 0.0, 0.0, x, y, 0.0, NOTHING, given_up, lengths, most, tables)


@pytest.mark.parametrize("block", [1, 2, 3])
def test_joined_cells_hold_the_greatest_occupancy(block):
    data = np.random.default_rng(block).integers(-1, 101, (31, 47)).astype(np.int8)
    data[np.random.default_rng(9).random(data.shape) < 0.6] = -1
    height, width = math.ceil(31 / block), math.ceil(47 / block)
    padded = np.full((height * block, width * block), -1, dtype=np.int8)
    padded[:31, :47] = data
    expected = padded.reshape(height, block, width, block).max(axis=(1, 3))
    np.testing.assert_array_equal(join_cells(data, block, 0, 0, height, width), expected)
    np.testing.assert_array_equal(join_cells(data, block, 2, 1, height - 4, width - 3), expected[2:-2, 1:-2])


def test_candidates_are_the_frontiers_by_the_cost_of_their_ways():
    data = room(doors=((0.5, 1.3), (2.8, 3.6)))
    found, *_ = candidates(data, 2.7, 1.0)
    assert len(found) == 2
    assert found[0, FRONTIER_COL] > found[1, FRONTIER_COL]
    grid = OccupancyGrid(join_cells(data, 2, 0, 0, 30, 40), 0.1, (0.0, 0.0))
    params = CostmapParams(BURGER.radius + 0.03, BURGER.radius + 0.48, 4.0)
    field = travel_field(make_costmap(grid, params), (2.7, 1.0))
    for row in found:
        cell = row[[GOAL_ROW, GOAL_COL]].astype(int)
        assert row[COST] == field.travel[cell[0] + 1, cell[1] + 1]
        assert frontier_mask(grid)[int(row[FRONTIER_ROW]), int(row[FRONTIER_COL])]
        assert row[GAIN] > 0
    assert len(candidates(data, 2.7, 1.0, most=1)[0]) == 1


def test_what_is_given_up_is_no_candidate():
    data = room(doors=((0.5, 1.3), (2.8, 3.6)))
    cells = frontier_near(data, 0.0, 0.0, 0.05, 2, 3.2, 2.1, 0.75, NOTHING)
    assert len(cells) >= 8
    found, *_ = candidates(data, 2.7, 1.0, given_up=cells)
    assert len(found) == 1
    assert found[0, FRONTIER_COL] < 20
    assert len(frontier_near(data, 0.0, 0.0, 0.05, 2, 3.2, 2.1, 0.75, cells)) == 0


@pytest.mark.parametrize("block", [1, 2])
def test_the_frontier_near_a_place_is_that_of_the_whole_map(block):
    rng = np.random.default_rng(3)
    data = np.where(rng.random((60, 80)) < 0.3, -1, rng.choice([0, 0, 0, 100], (60, 80))).astype(np.int8)
    joined = join_cells(data, block, 0, 0, 60 // block, 80 // block)
    side = 0.05 * block
    mask = frontier_mask(OccupancyGrid(joined, side, (1.0, -2.0)))
    for x, y in ((2.0, -0.5), (1.05, -1.9), (4.9, 0.9)):
        row, col = math.floor((y + 2.0) / side), math.floor((x - 1.0) / side)
        reach = math.ceil(0.4 / side - 1e-9)
        expected = {(r, c) for r, c in np.argwhere(mask).tolist() if (r - row) ** 2 + (c - col) ** 2 <= reach**2}
        found = frontier_near(data, 1.0, -2.0, 0.05, block, x, y, 0.4, NOTHING)
        cells = {(math.floor((v + 2.0) / side), math.floor((u - 1.0) / side)) for u, v in found}
        # On the edge of the map the slow way knows of no unknown cells beyond it.
        edge = {cell for cell in cells if cell[0] in (0, 60 // block - 1) or cell[1] in (0, 80 // block - 1)}
        assert cells - edge == expected - edge


@pytest.mark.parametrize("block", [1, 2])
def test_in_sight_is_what_lies_in_view_and_before_any_wall(block):
    data = room(doors=((0.5, 3.5),))
    data[38:48, 30:32] = 100
    frame = (data, 0.0, 0.0, 0.05, block, 2.3, 1.85)
    around = frontier_near(*frame, 1.5, NOTHING)
    assert around[:, 0].min() < 1.3
    in_sight = frontier_in_sight(*frame, 0.3, math.pi, 1.5, NOTHING)
    # The wall hides what is left of it, and nothing else.
    np.testing.assert_array_equal(in_sight, around[around[:, 0] > 1.6])
    bearings = np.arctan2(in_sight[:, 1] - 1.85, in_sight[:, 0] - 2.3)
    in_view = frontier_in_sight(*frame, 0.3, 0.8, 1.5, NOTHING)
    np.testing.assert_array_equal(in_view, in_sight[np.abs(bearings - 0.3) <= 0.8])
    assert 0 < len(in_view) < len(in_sight)
    assert len(frontier_in_sight(*frame, -2.0, 0.8, 1.5, NOTHING)) == 0


def test_long_frontiers_are_split_and_short_ones_wait():
    data = np.full((80, 200), -1, dtype=np.int8)
    data[:40] = 0
    data[:2] = 100
    data[:, :2] = data[:, -2:] = 100
    found, *_ = candidates(data, 5.0, 1.0)
    assert 4 <= len(found) <= 8
    columns = np.sort(found[:, FRONTIER_COL])
    # Each part is represented by its cell nearest to the robot, in the middle.
    assert (np.diff(columns) >= 1).all()
    assert np.diff(columns).max() <= 20
    assert np.ptp(columns) >= 60
    small = room(doors=((0.5, 0.9),))
    assert len(candidates(small, 2.0, 1.0, lengths=(100,))[0]) == 0
    assert len(candidates(small, 2.0, 1.0, lengths=(100, 2))[0]) == 1


def test_gaps_that_only_a_smaller_robot_would_pass_come_last():
    # A wall before the robot leaves a gap of 0.2 m; the frontier is too far behind it to be looked at from here.
    data = room(height=4.0, doors=((1.5, 2.5),))
    data[30:32] = 100
    data[30:32, 38:42] = 0
    counts = [len(candidates(data, 2.0, 0.5, lengths=(2,), tables=tables)[0]) for tables in TABLES]
    assert counts[0] == 0
    assert counts[-1] == 1


def test_paths_lead_to_the_goal_in_small_steps():
    data = room(doors=((0.5, 1.3),))
    found, costs, travel, came_by, top, left = candidates(data, 3.5, 0.5)
    path = np.empty((1024, 2))
    row, col = found[0, [GOAL_ROW, GOAL_COL]].astype(np.int64)
    frame = (0.1 * left, 0.1 * top, 0.1)
    count = write_path(costs, travel, came_by, row, col, TABLES[0].weights, 40, *frame, path)
    assert np.hypot(*(path[0] - (3.5, 0.5))) < 0.11
    np.testing.assert_allclose(path[count - 1], ((left + col + 0.5) * 0.1, (top + row + 0.5) * 0.1))
    assert np.hypot(*np.diff(path[:count], axis=0).T).max() <= 0.05 + 1e-9
    short = np.empty((10, 2))
    assert write_path(costs, travel, came_by, row, col, TABLES[0].weights, 40, *frame, short) == 10
    np.testing.assert_array_equal(short, path[:10])


def test_features_say_where_and_since_when():
    found, _, _, _, top, left = candidates(room(doors=((2.8, 3.6),)), 2.0, 1.0)
    features = np.ones((3, len(FEATURES)), dtype=np.float32)
    failures = np.array([[3.2, 2.1], [0.0, 0.0]])
    before = np.array([[3.3, 2.2, 40.0]])
    where = (top, left, 0.0, 0.0, 0.1, (2.0, 1.0, math.pi / 2), 100.0)
    places, seen = describe(found, *where, before, failures, (3.2, 2.15), 0.5, (314.0, 5.0, 3.0), features)
    named = dict(zip(FEATURES, features[0].tolist(), strict=True))
    x, y = places[0, 2:]
    assert named["ahead"] == pytest.approx((y - 1.0) / 16.0)
    assert named["left"] == pytest.approx((2.0 - x) / 16.0)
    assert named["age"] == pytest.approx(60.0 / 120.0)
    assert named["failures"] == pytest.approx(1 / 3)
    assert named["chosen"] == 1.0
    # The way to a door ahead on the right turns clockwise.
    assert -0.5 < named["turn"] < 0.0
    assert seen[0].tolist() == [x, y, 40.0]
    assert (features[1:] == 0.0).all()


def test_only_the_candidate_nearest_to_the_last_choice_is_marked():
    found, _, _, _, top, left = candidates(room(doors=((1.0, 1.4), (1.6, 2.0), (3.0, 3.6))), 2.0, 1.0)
    features = np.zeros((5, len(FEATURES)), dtype=np.float32)
    where = (top, left, 0.0, 0.0, 0.1, (2.0, 1.0, 0.0), 0.0, np.empty((0, 3)), NOTHING)
    places, _ = describe(found, *where, (1.48, 2.1), 0.5, (314.0, 5.0, 3.0), features)
    gaps = np.hypot(*(places[:, 2:] - (1.48, 2.1)).T)
    assert np.count_nonzero(gaps <= 0.5) == 2
    assert np.flatnonzero(features[:, 9]).tolist() == [gaps.argmin()]
    describe(found, *where, (9.0, 9.0), 0.5, (314.0, 5.0, 3.0), features)
    assert not features[:, 9].any()
