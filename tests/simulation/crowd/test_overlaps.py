import numpy as np
import pytest

from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd.overlaps import resolve_overlaps
from lidarnaut.envs.simulation.crowd.walls import list_walls
from tests.crowds import NO_ROBOTS, people_at

WALLS = list_walls(np.array([(-5.0, 0.0, 5.0, 0.0)]), np.empty((0, 3)), (-5.0, -5.0, 5.0, 5.0), 0.3)
FIRST_STANDS, FIRST_ON_ROUTE = [at.STANDING, at.ATTENTIVE], [at.FIXED_ROUTE, at.ATTENTIVE]


def settled(starts, wanted, kinds=at.ATTENTIVE, robots=NO_ROBOTS):
    people = people_at(wanted, kinds=kinds)
    stopped_by = resolve_overlaps(people, np.array(starts, dtype=float), robots, WALLS, 0.1)
    return people, stopped_by


@pytest.mark.parametrize(
    ("kinds", "starts", "wanted", "expected"),
    [
        (at.ATTENTIVE, [0.0, 0.7], [0.05, 0.55], [0.0, 0.6]),  # each parts by half
        (FIRST_STANDS, [0.0, 0.7], [0.0, 0.55], [0.0, 0.6]),
        (FIRST_STANDS, [0.0, 0.7], [0.0, 0.2], [0.0, 0.6]),
        (at.ATTENTIVE, [0.0], [1.0], [0.15]),  # at most half again the desired speed
        (FIRST_ON_ROUTE, [0.0, 0.6], [0.1, 0.6], [0.1, 0.7]),
    ],
)
def test_who_overlaps_is_moved_apart(kinds, starts, wanted, expected):
    people, _ = settled([(x, 2.0) for x in starts], [(x, 2.0) for x in wanted], kinds)
    np.testing.assert_allclose(people[:, :2], [(x, 2.0) for x in expected], atol=1e-9)


def test_walls_are_not_entered():
    people, _ = settled([(0.0, 0.32)], [(0.1, 0.25)])
    np.testing.assert_allclose(people[0, :2], (0.1, 0.3), atol=1e-9)
    people, _ = settled([(0.0, 0.9), (0.0, 0.3)], [(0.0, 0.8), (0.0, 0.3)], FIRST_ON_ROUTE)
    np.testing.assert_array_equal(people[:, :2], [(0.0, 0.9), (0.0, 0.3)])


def test_who_finds_no_room_stays():
    """Two standing people leave a gap that is too narrow, and push with equal strength from both sides."""
    people, _ = settled([(0.0, 2.0), (1.0, 2.0), (0.5, 2.4)], [(0.0, 2.0), (1.0, 2.0), (0.5, 2.0)], kinds=[2, 2, 0])
    np.testing.assert_array_equal(people[2, :2], (0.5, 2.4))


def test_a_robot_stops_who_walks_into_it_and_nobody_who_leaves():
    robots = np.array([(0.0, 2.0, 0.0, 0.0, 0.3)])
    starts = [(0.62, 2.0), (-0.58, 2.0)]
    people, stopped_by = settled(starts, [(0.57, 2.0), (-0.59, 2.0)], robots=robots)
    assert stopped_by.tolist() == [0, -1]
    np.testing.assert_allclose(people[:, :2], [(0.6, 2.0), (-0.59, 2.0)], atol=1.1e-4)
    assert people[0, at.X] > 0.6
    assert people[0, at.BLOCKED] == pytest.approx(0.5)
    assert people[1, at.BLOCKED] == 0.0


def test_people_on_fixed_routes_walk_through_walls_and_each_other():
    wanted = [(0.05, 0.0), (0.2, 0.0)]
    people, _ = settled([(0.0, 0.1), (0.1, 0.1)], wanted, kinds=at.FIXED_ROUTE)
    np.testing.assert_array_equal(people[:, :2], wanted)
