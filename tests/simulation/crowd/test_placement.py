from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.simulation.crowd import Crowd
from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.worlds.world import FixedRoute
from tests.crowds import HALL, SCENES, begin


@pytest.mark.parametrize(("scene", "size"), [*((scene, (0.2, 0.3)) for scene in SCENES), ("hall", (1.0, 1.0))])
def test_people_are_placed_apart_from_each_other_from_walls_and_from_robots(scene, size):
    world, crowd = SCENES[scene]
    crowd = replace(crowd, radius=size, number=crowd.number if size[0] < 1.0 else 5)
    robots = [(world.spawns[0].x, world.spawns[0].y, 0.0), (-4.0, 1.0, 0.0)]
    for seed in range(5):
        rows = begin(world, crowd, seed, robots).rows
        gaps = [clearance(x, y, world.segments, world.circles) for x, y in rows[:, :2]]
        assert (gaps > rows[:, at.RADIUS]).all()
        for x, y, _ in robots:
            assert (np.hypot(rows[:, at.X] - x, rows[:, at.Y] - y) > rows[:, at.RADIUS] + 0.3 + 1.0).all()
        apart = np.hypot(*(rows[:, None, :2] - rows[:, :2]).T) + 9.0 * np.eye(len(rows))
        assert (apart > rows[:, at.RADIUS] + rows[:, None, at.RADIUS]).all()


def test_people_are_drawn_by_what_the_crowd_says():
    crowd = Crowd(number=(40, 60), attentive=0.5, standing=0.2, radius=(0.15, 0.2), speed=(0.5, 1.0))
    rows = np.vstack([begin(HALL, crowd, seed).rows for seed in range(20)])
    counts = {len(begin(HALL, crowd, seed).rows) for seed in range(20)}
    assert 40 <= min(counts) < max(counts) <= 60
    for entry, (low, high) in ((at.RADIUS, (0.15, 0.2)), (at.SPEED, (0.5, 1.0))):
        assert low <= rows[:, entry].min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < rows[:, entry].max() <= high
    stands, blind = rows[:, at.KIND] == at.STANDING, rows[:, at.KIND] == at.BLIND
    assert stands.mean() == pytest.approx(0.2, abs=0.05)
    assert blind[~stands].mean() == pytest.approx(0.5, abs=0.07)
    quadrants = np.histogram2d(rows[:, at.X], rows[:, at.Y], bins=[[-6, 0, 6], [-6, 0, 6]])[0] / len(rows)
    np.testing.assert_allclose(quadrants, 0.25, atol=0.06)


def test_people_on_fixed_routes_are_kept_clear_of():
    route = FixedRoute(radius=0.5, waypoints=np.array([(-2.0, 0.0), (2.0, 0.0)]), speed=0.5)
    people = begin(replace(HALL, people=(route,)), Crowd(number=20, flow="along"))
    rows = people.rows
    assert rows[0, at.KIND] == at.FIXED_ROUTE
    assert (np.hypot(*(rows[1:, :2] - rows[0, :2]).T) > 0.8).all()
    np.testing.assert_array_equal(people.points[2:, 2], [3, 2])
    assert set(rows[1:, at.GOAL]) == {2.0, 3.0}


def test_more_people_than_there_is_room_for_are_refused():
    with pytest.raises(ValueError, match=r"world 'test' has room for \d+ of 500 people of a radius of 0.3 m"):
        begin(HALL, Crowd(number=500))
