import math

import numpy as np
import pytest

from lidarnaut.envs.geometry.clearance import clearance as slow_clearance
from lidarnaut.envs.simulation.crowd.walls import WALL_RANGE, clearance, list_walls, push_out
from tests.crowds import CYLINDERS, DOORWAY


@pytest.mark.parametrize("world", [CYLINDERS, DOORWAY])
def test_near_obstacles_give_the_clearance_from_all(world):
    walls = list_walls(world.segments, world.circles, world.bounds, 0.3)
    for x, y in np.random.default_rng(0).uniform(world.bounds[:2], world.bounds[2:], (500, 2)):
        expected = slow_clearance(x, y, world.segments, world.circles)
        if expected <= 0.3 + WALL_RANGE:
            assert clearance(*walls, x, y) == pytest.approx(expected, abs=1e-12)
        else:
            assert clearance(*walls, x, y) > 0.3 + WALL_RANGE


def test_beyond_the_world_nothing_is_near_and_a_disc_in_a_corner_is_pushed_out_of_both_walls():
    walls = list_walls(DOORWAY.segments, DOORWAY.circles, DOORWAY.bounds, 0.3)
    assert clearance(*walls, 100.0, -100.0) == math.inf
    assert push_out(*walls, -5.9, -3.8, 0.3) == pytest.approx((-5.7, -3.7, True))
    assert push_out(*walls, -3.0, 0.0, 0.3) == (-3.0, 0.0, True)


def test_a_disc_that_fits_nowhere_near_is_wedged():
    segments = np.array([(-5.0, -0.2, 5.0, -0.2), (-5.0, 0.2, 5.0, 0.2)])
    walls = list_walls(segments, np.empty((0, 3)), (-5.0, -0.2, 5.0, 0.2), 0.3)
    x, y, is_free = push_out(*walls, 0.0, 0.05, 0.3)
    assert not is_free
    assert math.isfinite(x + y)
