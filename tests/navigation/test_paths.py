import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from lidarnaut.envs import navigation
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.lines import resample
from lidarnaut.envs.navigation import CostmapParams, is_path_valid, make_costmap, plan_path
from lidarnaut.envs.navigation.search.astar import DIAGONAL, STEPS, STRAIGHT, UNREACHED, search, step_weights
from lidarnaut.envs.navigation.search.paths import exits, smooth_path
from tests.navigation.driving import cost_at

PARAMS = CostmapParams(robot_radius=0.2, inflation_radius=0.6)


def reference_travel(costs, weights, start):
    """Dijkstra over an explicit graph; cells in collision lead only to other cells in collision and out."""
    height, width = costs.shape

    def is_open(row, col, escaping):
        if not (0 <= row < height and 0 <= col < width):
            return False
        return weights[costs[row, col]] > 0 and (costs[row, col] != 253 or escaping)

    rows, cols, lengths = [], [], []
    for row in range(height):
        for col in range(width):
            escaping = costs[row, col] in (253, 254)
            for k, (d_row, d_col) in enumerate(STEPS):
                corners = [(row + d_row, col + d_col)] + ([(row + d_row, col), (row, col + d_col)] if k >= 4 else [])
                if all(is_open(*corner, escaping) for corner in corners):
                    rows.append(row * width + col)
                    cols.append((row + d_row) * width + col + d_col)
                    weight = int(weights[costs[row + d_row, col + d_col]])
                    lengths.append(weight * (STRAIGHT if k < 4 else DIAGONAL))
    graph = coo_array((lengths, (rows, cols)), shape=(height * width, height * width)).tocsr()
    return dijkstra(graph, indices=start[0] * width + start[1]).reshape(height, width)


def random_costs(rng, height, width):
    values = np.array([0, 0, 0, 40, 252, 253, 254, 255], dtype=np.uint8)
    if rng.integers(2):
        return values[rng.integers(0, len(values), (height, width))]
    costs = np.zeros((height, width), dtype=np.uint8)
    for _ in range(rng.integers(8)):
        row, col, tall, wide = rng.integers(0, (height, width, 8, 8))
        costs[row : row + tall + 1, col : col + wide + 1] = rng.choice(values)
    return costs


@settings(max_examples=80, deadline=None)
@given(st.integers(1, 20), st.integers(1, 20), st.booleans(), st.integers(0, 2**32 - 1))
def test_travel_costs_equal_scipys_exactly(height, width, allow_unknown, seed):
    rng = np.random.default_rng(seed)
    costs, weights = random_costs(rng, height, width), step_weights(3.0, allow_unknown)
    start = int(rng.integers(height)), int(rng.integers(width))
    goal = int(rng.integers(height)), int(rng.integers(width))
    expected = reference_travel(costs, weights, start)
    travel = search(costs, weights, *start, -1, -1)[0][1:-1, 1:-1]
    np.testing.assert_array_equal(np.where(travel == UNREACHED, np.inf, travel), expected)
    # A* has to find the same cost for its goal, independent of the heuristic.
    to_goal = search(costs, weights, *start, *goal)[0][1:-1, 1:-1][goal]
    assert (np.inf if to_goal == UNREACHED else to_goal) == expected[goal]


def test_a_star_opens_fewer_cells_than_dijkstra():
    costs = np.zeros((200, 200), dtype=np.uint8)
    travel = search(costs, step_weights(3.0, False), 100, 20, 140, 180)[0]
    # Ties prefer the cell with the highest cost-to-come: only cells near the path are expanded.
    assert np.count_nonzero(travel < UNREACHED) < 1000


def two_rooms():
    """Two rooms of 3 m x 3 m and a door of 0.8 m, with a pillar in front of it; row 0 is the lowest y."""
    data = np.zeros((60, 120), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[:22, 60] = data[38:, 60] = 100
    data[28:32, 80:84] = 100
    return OccupancyGrid(data, 0.05, (-1.0, -2.0))


def test_a_path_leads_there_and_keeps_away():
    grid = two_rooms()
    costmap = make_costmap(grid, PARAMS)
    start, goal = (-0.5, -1.5), (4.5, 0.5)
    path = plan_path(costmap, start, goal)
    assert np.abs(path[0] - start).max() <= 0.025 + 1e-9
    assert np.abs(path[-1] - goal).max() <= 0.025 + 1e-9
    gaps = np.hypot(*np.diff(path, axis=0).T)
    assert gaps.max() <= 0.05 + 1e-9
    walls = grid.centers(np.argwhere(grid.data == 100))
    assert min(np.hypot(*(walls - point).T).min() for point in path) > 0.2
    # Straight lines instead of staircases: barely longer than the taut string around the door's posts.
    door = np.array([grid.centers(np.array([30, 60]))])
    taut = np.hypot(*(door[0] - start)) + np.hypot(*(door[0] - goal))
    assert gaps.sum() < 1.1 * taut
    np.testing.assert_array_equal(path, plan_path(costmap, start, goal))


def test_a_goal_in_a_wall_is_reached_within_the_tolerance():
    costmap = make_costmap(two_rooms(), PARAMS)
    assert plan_path(costmap, (-0.5, -1.5), (4.97, 0.5)) is None
    path = plan_path(costmap, (-0.5, -1.5), (4.97, 0.5), tolerance=0.3)
    assert 0.2 < np.hypot(*(path[-1] - (4.97, 0.5))) <= 0.3 + 0.05
    assert plan_path(costmap, (-0.5, -1.5), (9.0, 0.5), tolerance=0.3) is None


def test_a_robot_touching_a_wall_in_its_belief_still_gets_away():
    costmap = make_costmap(two_rooms(), PARAMS)
    beside, inside = (-0.87, -1.0), (-0.98, -1.0)
    assert cost_at(costmap, *beside) == 253
    assert cost_at(costmap, *inside) == 254
    for start in (beside, inside):
        path = plan_path(costmap, start, (0.5, 0.0))
        costs = [cost_at(costmap, *point) for point in path]
        # Once out of the inscribed radius of the wall, the path stays out.
        out = next(k for k, cost in enumerate(costs) if cost < 253)
        assert max(costs[out:]) < 253


def test_the_cost_of_one_cell_is_that_of_many():
    data = np.zeros((12, 9), dtype=np.int8)
    data[:, 6] = 100
    costmap = make_costmap(OccupancyGrid(data, 0.1, (0.0, 0.0)), CostmapParams(0.1, 0.1))
    field = navigation.travel_field(costmap, (0.25, 0.25))
    lengths = [[field.length(row, col) for col in range(-1, 10)] for row in range(-1, 13)]
    expected = np.pad(field.cost(np.moveaxis(np.indices(data.shape), 0, -1)), 1, constant_values=math.inf)
    np.testing.assert_array_equal(lengths, expected)
    assert 0 < np.isfinite(expected).sum() < data.size


def hall():
    """Hall of 6 m x 3 m, unknown beyond x = 5, with a wall to the height of 2 m at x = 2."""
    data = np.zeros((60, 120), dtype=np.int8)
    data[:, 100:] = -1
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[:40, 40] = 100
    return OccupancyGrid(data, 0.05, (0.0, 0.0))


COSTMAP = make_costmap(hall(), PARAMS)


def test_a_path_is_valid_until_an_obstacle_blocks_it():
    path = plan_path(COSTMAP, (1.0, 0.5), (3.0, 0.5))
    assert is_path_valid(COSTMAP, path)
    grid = hall()
    grid.data[50, 40] = 100
    assert not is_path_valid(make_costmap(grid, PARAMS), path)
    # Obstacles on the passed part of the path are ignored.
    assert is_path_valid(make_costmap(grid, PARAMS), path[-20:])


def test_a_path_through_the_unknown_or_off_the_map_is_not_valid():
    line = resample(np.array([[4.0, 1.5], [5.5, 1.5]]), 0.05)
    assert not is_path_valid(COSTMAP, line)
    assert is_path_valid(COSTMAP, line, allow_unknown=True)
    assert not is_path_valid(COSTMAP, line + (5.0, 0.0), allow_unknown=True)


def test_a_path_may_begin_where_the_robot_touches_something_but_not_return_there():
    out = resample(np.array([[1.85, 1.0], [1.0, 1.0]]), 0.05)
    assert cost_at(COSTMAP, *out[0]) == 253
    assert is_path_valid(COSTMAP, out)
    assert not is_path_valid(COSTMAP, out[::-1])
    assert not is_path_valid(COSTMAP, out[:1])


def turning(path):
    """Sum of squared turns per step, of chords long enough to average over cells."""
    chords = path[4:] - path[:-4]
    angles = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    return float((np.diff(angles) ** 2).sum())


def test_smoothing_rounds_corners_and_touches_nothing():
    path = plan_path(COSTMAP, (1.0, 0.5), (3.0, 0.5))
    smooth = smooth_path(COSTMAP, path)
    np.testing.assert_allclose(smooth[[0, -1]], path[[0, -1]])
    assert turning(smooth) < 0.7 * turning(path)
    assert is_path_valid(COSTMAP, smooth)
    assert np.hypot(*np.diff(smooth, axis=0).T).max() <= 0.05 + 1e-9
    corner = resample(np.array([[1.7, 1.0], [1.7, 2.3], [2.4, 2.3], [2.4, 1.0]]), 0.05)
    assert is_path_valid(COSTMAP, smooth_path(COSTMAP, corner))
    assert len(smooth_path(COSTMAP, path[:1])) == 1
    line = resample(np.array([[0.5, 2.5], [4.5, 2.5]]), 0.05)
    np.testing.assert_allclose(smooth_path(COSTMAP, line), line, atol=1e-9)


def test_exits_lead_out_of_obstacles_of_the_map_where_the_scan_is_free():
    grid = OccupancyGrid(np.zeros((60, 60), dtype=np.int8), 0.05, (-1.5, -1.5))
    grid.data[24:36, 24:36] = 100  # 0.6 m around the robot
    costmap, pose = make_costmap(grid, CostmapParams(0.1, 0.5)), Pose2D(0.0, 0.0, 0.5)
    found = exits(costmap, pose, np.empty((0, 2)), 1.0)
    assert all(costmap.costs[tuple(grid.cells(path[-1]))] <= 252 for path in found)
    assert math.dist(found[0][0], found[0][-1]) == pytest.approx(0.45, abs=0.051)
    ahead = exits(costmap, pose, np.array([[-0.15, y] for y in np.linspace(-0.5, 0.5, 30)]), 1.0)
    assert 0 < len(ahead) < len(found)
    assert all(pose.inverse().transform(path[-1:])[0, 0] > -0.1 for path in ahead)
    assert exits(costmap, pose, np.empty((0, 2)), 0.3) == []
    assert exits(costmap, Pose2D(1.0, 1.0, 0.0), np.empty((0, 2)), 1.0) == []
