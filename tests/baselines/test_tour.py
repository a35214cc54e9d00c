"""What a tour is made of: the ways between its stops, on a raster of cells as large as the robot's radius."""

import numpy as np
import pytest

from baselines.survey import Survey
from baselines.tour import FAR, _lengths, _pool
from envs.geometry import OccupancyGrid
from envs.navigation import COST_INSCRIBED, COST_UNKNOWN, CostmapParams, travel_field
from tests.baselines.places import belief_at, survey_from


def rooms_with_a_door(width):
    """Two rooms of 4 m x 4 m beside each other; the wall between them has a door of so many cells."""
    data = np.full((84, 165), 100, dtype=np.int8)
    data[2:82, 2:82] = data[2:82, 84:163] = 0
    data[40 : 40 + width, 82:84] = 0
    return OccupancyGrid(data, 0.05, (0.0, 0.0))


def test_lengths_are_those_of_the_fine_raster_to_within_a_few_cells():
    survey, rng = survey_from(1.0, 1.0, rooms_with_a_door(16)), np.random.default_rng(0)
    places = np.column_stack([rng.integers(8, 76, 8), rng.integers(8, 155, 8)])
    places = places[np.isfinite(survey.field.cost(places))]
    lengths = _lengths(survey, places)
    np.testing.assert_array_equal(lengths, lengths.T)
    assert len(places) >= 6
    for k, place in enumerate(places):
        x, y = survey.grid.centers(place)
        exact = travel_field(survey.costmap, (float(x), float(y))).cost(places)
        np.testing.assert_allclose(lengths[k + 1, 1:], exact, rtol=0.12, atol=0.35)
    np.testing.assert_allclose(lengths[0, 1:], survey.field.cost(places), rtol=0.12, atol=0.35)


@pytest.mark.parametrize(("width", "is_open"), [(0, False), (2, False), (7, True), (9, True)])
def test_larger_cells_neither_open_walls_nor_close_doors(width, is_open):
    # The robot needs 7 cells.
    survey = survey_from(1.0, 1.0, rooms_with_a_door(width))
    far = np.array([[40, 140]])
    assert np.isfinite(survey.field.cost(far)[0]) == is_open
    assert (_lengths(survey, far)[0, 1] < FAR) == is_open


def test_a_larger_cell_is_as_dear_as_its_cheapest_part():
    rng = np.random.default_rng(1)
    grid = OccupancyGrid(
        rng.choice(np.array([-1, 0, 100], dtype=np.int8), (31, 44), p=[0.1, 0.89, 0.01]), 0.05, (1.0, 2.0)
    )
    costmap = Survey(belief_at(1.0, 2.0, grid), CostmapParams(0.155, 0.6, 4.0)).costmap
    coarse, fine = _pool(costmap), costmap.costs
    height, width = fine.shape
    assert coarse.grid.resolution == pytest.approx(0.15)
    assert coarse.costs.shape == (-(-height // 3), -(-width // 3))
    for row, col in np.ndindex(coarse.costs.shape):
        assert coarse.costs[row, col] == fine[3 * row : 3 * row + 3, 3 * col : 3 * col + 3].min()
    assert {int((fine < COST_INSCRIBED).any()), int((fine == COST_UNKNOWN).any())} == {1}
