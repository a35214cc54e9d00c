from itertools import permutations

import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines.frontier.open_tour import best_tours, tour_length
from lidarnaut.baselines.frontier.tour import UNREACHABLE_LENGTH, TourExplorer, path_lengths
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import CostmapParams, make_costmap, travel_field
from tests.baselines.maps import BURGER, belief_at, candidates_from, corridor, first_choice, reading_of


def random_lengths(rng, num_stops):
    points = rng.uniform(0.0, 10.0, (num_stops + 1, 2))
    return np.hypot(*(points[:, None] - points).transpose(2, 0, 1))


def test_tours_are_almost_always_the_shortest_there_are():
    rng = np.random.default_rng(0)
    excess = []
    for _ in range(40):
        lengths = random_lengths(rng, 6)
        tours, totals = best_tours(lengths)
        for k in range(6):
            rest = [stop for stop in range(1, 7) if stop != k + 1]
            shortest = min(tour_length(lengths, np.array([0, k + 1, *order])) for order in permutations(rest))
            assert totals[k] >= shortest - 1e-9
            assert totals[k] == tour_length(lengths, tours[k])
            excess.append(totals[k] / shortest - 1.0)
    assert np.mean(np.array(excess) < 1e-9) > 0.9
    assert np.max(excess) < 0.15


def test_tours_pass_every_stop_once_and_begin_with_the_fixed_ones():
    tours, _ = best_tours(random_lengths(np.random.default_rng(1), 16))
    for k, tour in enumerate(tours):
        assert list(tour[:2]) == [0, k + 1]
        assert sorted(tour) == list(range(17))


def rooms_with_a_door(width):
    """Two adjacent rooms of 4 m x 4 m with a door of `width` cells."""
    data = np.full((84, 165), 100, dtype=np.int8)
    data[2:82, 2:82] = data[2:82, 84:163] = 0
    data[40 : 40 + width, 82:84] = 0
    return make_costmap(OccupancyGrid(data, 0.05, (0.0, 0.0)), CostmapParams(0.155, 0.6, 4.0))


def test_lengths_are_those_of_the_fine_raster_to_within_a_few_cells():
    costmap, rng = rooms_with_a_door(16), np.random.default_rng(0)
    field = travel_field(costmap, (1.0, 1.0))
    cells = np.column_stack([rng.integers(8, 76, 8), rng.integers(8, 155, 8)])
    cells = cells[np.isfinite(field.cost(cells))]
    lengths = path_lengths(costmap, (1.0, 1.0), costmap.grid.centers(cells))
    np.testing.assert_array_equal(lengths, lengths.T)
    assert len(cells) >= 6
    for k, cell in enumerate(cells):
        x, y = costmap.grid.centers(cell)
        exact = travel_field(costmap, (float(x), float(y))).cost(cells)
        np.testing.assert_allclose(lengths[k + 1, 1:], exact, rtol=0.12, atol=0.35)
    np.testing.assert_allclose(lengths[0, 1:], field.cost(cells), rtol=0.12, atol=0.35)


@pytest.mark.parametrize(("width", "is_open"), [(0, False), (2, False), (7, True), (9, True)])
def test_larger_cells_neither_open_walls_nor_close_doors(width, is_open):
    costmap, far = rooms_with_a_door(width), np.array([[40, 140]])
    assert np.isfinite(travel_field(costmap, (1.0, 1.0)).cost(far)[0]) == is_open
    assert (path_lengths(costmap, (1.0, 1.0), costmap.grid.centers(far))[0, 1] < UNREACHABLE_LENGTH) == is_open


def test_a_tour_finishes_what_is_near_before_it_leaves_for_good():
    # A dead end 1.5 m to the left; the path on 1.2 m to the right: nearest-first goes right, and has to come back.
    grid = corridor((160, 169), (225, 230), (300, 320))
    assert first_choice(make_policy("nearest"), 10.0, -0.5, grid)[0] > 11.0
    assert first_choice(make_policy("tour"), 10.0, -0.5, grid)[0] < 9.0


def test_a_tour_is_kept_to_unless_another_one_is_clearly_shorter():
    grid, explorer = corridor((160, 169), (231, 240)), TourExplorer()
    explorer.rule.reset(BURGER, np.random.default_rng(0))

    def choice(rule, x):
        candidates = candidates_from(x, -0.5, grid, planning=explorer.planning)
        return candidates["frontier"][rule(candidates, belief_at(x, -0.5, grid)).argmax()][0]

    assert choice(explorer.rule, 10.0) < 9.0
    # A step to the other side makes the other order slightly shorter; a longer step makes the difference clear.
    assert choice(explorer.rule, 10.2) < 9.0
    assert first_choice(TourExplorer(), 10.2, -0.5, grid)[0] > 11.0
    assert choice(explorer.rule, 11.2) > 11.0
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    for _ in range(12):
        explorer.act(reading_of(), belief_at(10.0, -0.5, grid))
    assert explorer.plan[-1, 0] < 9.0
    for _ in range(30):
        explorer.act(reading_of(), belief_at(11.2, -0.5, grid))
    assert explorer.plan[-1, 0] > 11.0
