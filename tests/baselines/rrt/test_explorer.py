import numpy as np
import pytest
from sklearn.cluster import MeanShift

from lidarnaut.baselines import RrtExplorer, RrtParams
from lidarnaut.baselines.rrt.detector import RrtDetector, mean_shift
from lidarnaut.baselines.rrt.team import UNASSIGNED, RrtRobot, assign
from lidarnaut.baselines.rrt.trees import BLOCKED, CLEAR, UNKNOWN_AHEAD, Tree, grid_check, nearest
from lidarnaut.envs.geometry import OccupancyGrid
from tests.baselines.maps import BURGER, belief_at, reading_of


def rooms():
    """Two rooms of 5 m x 4 m, joined by a door of 1 m; the right room has its frontier along its right side."""
    data = np.full((104, 240), -1, dtype=np.int8)
    data[12:92, 2:202] = 0
    data[:12] = data[92:] = data[:, :2] = 100
    data[12:92, 100:102] = 100
    data[42:62, 100:102] = 0
    return OccupancyGrid(data, 0.05, (-1.0, -2.6))


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ((0.5, 0.5), (2.5, 0.7), (CLEAR, 2.5, 0.7)),
        ((0.5, 0.5), (6.5, 0.5), (BLOCKED, 3.5, 0.5)),
        ((3.5, 0.5), (6.5, 0.5), (UNKNOWN_AHEAD, 5.5, 0.5)),  # a new obstacle at the start blocks nothing
        ((6.5, 0.5), (0.5, 0.5), (UNKNOWN_AHEAD, 5.5, 0.5)),
        ((0.5, 0.5), (0.5, -3.5), (UNKNOWN_AHEAD, 0.5, -0.5)),  # outside of the map
        ((0.2, 0.9), (2.9, 3.6), (BLOCKED, 2.5, 2.5)),
    ],
)
def test_the_first_cell_on_a_line_that_is_not_free_decides(start, end, expected):
    data = np.zeros((4, 7), dtype=np.int8)
    data[0, 3], data[0, 4], data[0, 5], data[2, 2] = 100, 49, -1, 50
    assert grid_check(data, *start, *end) == expected


def test_nearest_equals_a_search_of_all_distances():
    rng = np.random.default_rng(1)
    vertices = rng.uniform(0, 100, (2, 500)).astype(np.float32)
    for count in (1, 2, 15, 16, 17, 33, 500):
        for x, y in rng.uniform(0, 100, (20, 2)).astype(np.float32):
            squared = (vertices[0, :count] - x) ** 2 + (vertices[1, :count] - y) ** 2
            assert squared[nearest(vertices, count, x, y)] == pytest.approx(squared.min(), rel=1e-5)


def grown(tree, grid, num_steps, robot=(0.0, 0.0)):
    rng = np.random.default_rng(0)
    x0, y0, x1, y1 = grid.bounds
    return [tree.grow(grid, rng.uniform((x0, y0), (x1, y1), (200, 2)), robot) for _ in range(num_steps)]


@pytest.mark.parametrize("eta", [1.0, 15.0])
def test_the_global_tree_stays_in_free_space_and_finds_the_frontier_behind_the_door(eta):
    grid = rooms()
    tree = Tree((0.0, 0.0), eta=eta, resets=False)
    found = np.concatenate(grown(tree, grid, 20))
    assert len(tree.vertices) > 50
    np.testing.assert_allclose(tree.vertices[0], (0.0, 0.0), atol=1e-5)
    rows, cols = grid.cells(tree.vertices).T
    assert (grid.data[rows, cols] == 0).all()
    gaps = distances(tree.vertices, tree.vertices)
    assert gaps[~np.eye(len(gaps), dtype=bool)].min() >= 0.3 - 1e-4
    np.testing.assert_allclose(tree.edges[:, 1], tree.vertices[1:], atol=1e-5)
    for k, (parent, end) in enumerate(tree.edges, start=1):
        assert (np.abs(tree.vertices[:k] - parent).max(axis=1) < 1e-5).any()
        assert np.hypot(*(end - parent)) <= eta + 1e-4
        assert grid_check(grid.data, *((np.array([parent, end]) - grid.origin) / grid.resolution).ravel())[0] == CLEAR
    # All frontier points are along the open side at x = 9.1, from wall to wall.
    np.testing.assert_allclose(found[:, 0], 9.125, atol=1e-9)
    assert found[:, 1].min() < -1.5
    assert found[:, 1].max() > 1.5
    assert Tree((0.0, 0.0), eta=1.0, resets=False).edges.shape == (0, 2, 2)


def test_the_local_tree_starts_again_at_the_robot_after_a_find():
    grid = rooms()
    local = Tree((0.0, 0.0), eta=1.0, resets=True)
    assert len(np.concatenate(grown(local, grid, 20, robot=(8.0, 1.0)))) > 20
    np.testing.assert_allclose(local.vertices[0], (8.0, 1.0), atol=1e-5)
    # A room without a frontier is no reason to reset the local tree.
    grid.data[42:62, 100:102] = 100
    local = Tree((0.0, 0.0), eta=1.0, resets=True)
    assert len(np.concatenate(grown(local, grid, 20, robot=(1.0, 1.0)))) == 0
    np.testing.assert_allclose(local.vertices[0], (0.0, 0.0), atol=1e-5)
    assert local.vertices[:, 0].max() < 4.0


def test_a_tree_stays_where_it_is_when_the_map_grows():
    grid, tree = rooms(), Tree((0.0, 0.0), eta=1.0, resets=False)
    grown(tree, grid, 3)
    before = tree.vertices.copy()
    larger = np.pad(grid.data, ((40, 0), (60, 10)), constant_values=-1)
    tree.grow(OccupancyGrid(larger, 0.05, (-4.0, -4.1)), np.array([[0.0, 0.0]]), (0.0, 0.0))
    np.testing.assert_allclose(tree.vertices, before, atol=1e-4)


def test_mean_shift_equals_scikit_learn():
    rng = np.random.default_rng(2)
    for n in (1, 2, 40, 150):
        points = rng.uniform(0.0, 3.0, (n, 2))
        points[n // 2 :] = points[: n - n // 2] + rng.normal(0.0, 0.05, (n - n // 2, 2))
        expected = MeanShift(bandwidth=0.3).fit(points).cluster_centers_
        np.testing.assert_allclose(mean_shift(points, 0.3), expected, atol=1e-9)
    assert mean_shift(np.empty((0, 2)), 0.3).shape == (0, 2)


def island_map():
    """Free map with unknown squares of 1 m^2 around (2, 2) and 0.25 m^2 around (8, 2) and (5, 8)."""
    data = np.zeros((200, 200), dtype=np.int8)
    data[30:50, 30:50] = data[35:45, 155:165] = data[155:165, 95:105] = -1
    return OccupancyGrid(data, 0.05, (0.0, 0.0))


ISLANDS = np.array([[2.0, 2.0], [8.0, 2.0], [5.0, 8.0]])


def distances(robots, points):
    return np.hypot(*(robots[:, None] - points[None]).transpose(2, 0, 1))


@pytest.mark.parametrize(("x", "best"), [(6.0, 1), (5.0, 0), (7.5, 1), (3.0, 0)])
def test_one_robot_gets_the_point_of_the_greatest_revenue(x, best):
    # R of the islands from (6, 2): 3 * 1 - 4 = -1, 3 * 2 * 0.25 - 2 = -0.5, 3 * 0.25 - 6.1 = -5.3.
    # At 5.0 the first two are 3 m away: h doubles both gains.
    robots, gains = np.array([[x, 2.0]]), np.array([1.0, 0.25, 0.25])
    costs = distances(robots, ISLANDS)
    revenues = 3.0 * np.where(costs[0] <= 3.0, 2.0, 1.0) * gains - costs[0]
    assert np.argmax(revenues) == best
    assert assign(island_map(), robots, ISLANDS, costs, RrtParams()).tolist() == [best]


def test_two_robots_do_not_share_a_point_or_what_there_is_to_see():
    grid = island_map()
    # Two points on one island, a small island elsewhere. The first robot sees all of the island from either point.
    points = np.array([[2.0, 2.0], [2.1, 2.0], [5.0, 8.0]])
    robots = np.array([[1.5, 2.0], [3.0, 5.0]])
    costs = distances(robots, points)
    # For the second robot the large island is worth more, unless the first robot has it.
    assert assign(grid, robots[1:], points, costs[1:], RrtParams())[0] in (0, 1)
    first, second = assign(grid, robots, points, costs, RrtParams())
    assert first in (0, 1)
    assert second == 2
    # Without the discount of gains, it would go to the other point of the large island.
    assert (6.0 * 1.0 - costs[1, 1 - first]) > (3.0 * 0.25 - costs[1, 2])


def test_three_robots_take_three_points_and_a_fourth_gets_none():
    robots = np.array([[7.5, 2.0], [5.0, 7.5], [1.0, 2.0], [9.0, 9.0]])
    costs = distances(robots, ISLANDS)
    for count, expected in ((3, [1, 2, 0]), (4, [1, 2, 0, UNASSIGNED])):
        assert assign(island_map(), robots[:count], ISLANDS, costs[:count], RrtParams()).tolist() == expected
    # Points that cannot be reached are not assigned.
    costs[2] = np.inf
    assert assign(island_map(), robots[:3], ISLANDS, costs[:3], RrtParams())[2] == UNASSIGNED
    assert assign(island_map(), robots, ISLANDS[:0], costs[:, :0], RrtParams()).tolist() == [UNASSIGNED] * 4


def test_the_filter_keeps_few_points_and_drops_stale_ones():
    grid, detector = rooms(), RrtDetector(RrtParams(), np.random.default_rng(0))
    for _ in range(20):
        detector.detect(grid, [(0.0, 0.0)])
    assert 3 <= len(detector.points) <= 16
    assert distances(detector.points, detector.points)[~np.eye(len(detector.points), dtype=bool)].min() > 0.3
    grid.data[12:92, 202:239] = 0
    grid.data[:, 239] = 100
    detector.detect(grid, [(0.0, 0.0)])
    assert len(detector.points) == 0


def navigator_at(grid, points, **params):
    navigator = RrtRobot(BURGER, 0.1, RrtParams(**params), 0)
    navigator.points = points
    navigator.begin(reading_of(), belief_at(0.0, 0.0, grid))
    return navigator


def test_candidates_are_the_frontier_cells_nearest_to_the_points():
    rng = np.random.default_rng(5)
    grid = rooms()
    # The frontier is along x = 9.05, from wall to wall; points farther away than the bandwidth have none.
    points = np.column_stack([rng.uniform(8.0, 10.0, 200), rng.uniform(-1.5, 1.5, 200)])
    navigator = navigator_at(grid, points, bandwidth=0.3)
    cells = navigator.map.grid.centers(np.argwhere(navigator.map.frontier))
    gaps = distances(points, cells)
    expected = cells[gaps.argmin(axis=1)][gaps.min(axis=1) <= 0.3]
    assert 20 < len(expected) < 180
    assert {tuple(cell) for cell in navigator.candidates["frontier"].round(6)} == {tuple(c) for c in expected.round(6)}
    assert len(navigator_at(grid, np.empty((0, 2))).candidates) == 0


def test_points_in_costly_cells_and_beyond_walls_are_invalid():
    grid = rooms()
    points = np.array([[9.05, 0.0], [9.05, -1.93]])
    # The second point is within the inflation radius of the wall.
    assert len(navigator_at(grid, points).candidates) == 1
    assert len(navigator_at(grid, points, max_cost=99.0).candidates) == 2
    grid.data[42:62, 100:102] = 100
    assert len(navigator_at(grid, points).candidates) == 0


@pytest.mark.parametrize("door_closes", [False, True])
def test_an_episode_ends_after_patience_without_frontiers_that_can_be_reached(door_closes):
    grid, explorer = rooms(), RrtExplorer(RrtParams(patience=250))
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    if door_closes:
        # The global tree stays behind the door, and still finds frontiers.
        for _ in range(20):
            explorer.act(reading_of(), belief_at(0.0, 0.0, grid))
        grid.data[42:62, 100:102] = 100
    else:
        grid.data[12:92, 202:] = 100
    belief = belief_at(0.0, 0.0, OccupancyGrid(grid.data.copy(), grid.resolution, grid.origin))
    steps = 0
    while explorer.end_reason is None and steps < 1000:
        explorer.act(reading_of(), belief)
        steps += 1
    assert 250 - 20 * door_closes <= steps < 500
    assert explorer.end_reason == "no_reachable_frontier"
    assert (len(explorer.markers.clusters) > 0) == door_closes
    assert explorer.act(reading_of(), belief) == (0.0, 0.0)


def with_small_frontiers(*sides):
    """Room of 8 m x 4 m around (0, 0), with a niche of unknown cells in the `sides` (x, y) [m]."""
    data = np.full((88, 168), 100, dtype=np.int8)
    data[4:84, 4:164] = 0
    grid = OccupancyGrid(data, 0.05, (-4.2, -2.2))
    for side in sides:
        row, col = grid.cells(np.array(side))
        data[row - 4 : row + 5, col - 4 : col + 5] = -1
    return grid


def steered(grid, num_steps, **params):
    """Commands and targets of an explorer that stays at the origin."""
    explorer = RrtExplorer(RrtParams(**params))
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    twists, targets = [], []
    for _ in range(num_steps):
        belief = belief_at(0.0, 0.0, grid)
        twists.append(explorer.act(reading_of(), belief))
        targets.append(explorer._navigator.targets[0])
    return twists, np.array(targets)


@pytest.mark.parametrize(
    ("other", "params", "x"),
    [
        ((-3.8, 0.0), {}, 3.0),
        ((-3.8, 0.0), {"period": 0.1}, 3.0),  # the robot gets points again during its drive
        ((-2.6, 0.0), {"period": 0.1}, -2.6),
        ((-2.6, 0.0), {"period": 0.1, "turn_cost": 1.0}, 3.0),
    ],
)
def test_the_best_point_is_kept_and_a_turn_counts_as_path_length(other, params, x):
    _, targets = steered(with_small_frontiers((3.0, 0.0), other), 15, **params)
    assert (np.hypot(*(targets - (x, 0.0)).T) < 0.6).all()


def test_with_pursuit_a_robot_does_not_stop_to_turn():
    grid = with_small_frontiers((1.5, 2.0))
    speeds = [[twist.v for twist in steered(grid, 5, pursuit=pursuit)[0]] for pursuit in (False, True)]
    assert max(speeds[0]) == 0.0
    assert min(speeds[1]) > 0.1 * BURGER.max_v


@pytest.mark.parametrize(
    ("costs", "best"),
    [
        # The islands are in full view: 1 m2 at 4 m, 0.25 m2 at 2 m, and the latter at 6.1 m.
        ((4.0, 2.0, 6.1), 0),
        ((4.0, 0.7, 6.1), 1),
        ((np.inf, np.inf, 6.1), 2),
        ((np.inf, np.inf, np.inf), UNASSIGNED),
    ],
)
def test_revenue_by_unknown_area_in_view_is_per_path_cost(costs, best):
    robots, params = np.array([[6.0, 2.0]]), RrtParams(view_radius=1.0)
    assert assign(island_map(), robots, ISLANDS, np.array([costs]), params).tolist() == [best]
