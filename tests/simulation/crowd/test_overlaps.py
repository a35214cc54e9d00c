import numpy as np
import pytest

from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd.overlaps import resolve_overlaps
from lidarnaut.envs.simulation.crowd.walls import list_walls

NO_ROBOTS = np.empty((0, 5))
WALLS = list_walls(np.array([(-5.0, 0.0, 5.0, 0.0)]), np.empty((0, 3)), (-5.0, -5.0, 5.0, 5.0), 0.3)


def people_at(*positions, kind=at.ATTENTIVE):
    rows = np.zeros((len(positions), at.PERSON_SIZE))
    rows[:, [at.X, at.Y]] = positions
    rows[:, at.RADIUS], rows[:, at.SPEED], rows[:, at.KIND] = 0.3, 1.0, kind
    return rows


def settled(starts, wanted, kinds=at.ATTENTIVE, robots=NO_ROBOTS):
    people = people_at(*wanted)
    people[:, at.KIND] = kinds
    stopped_by = resolve_overlaps(people, np.array(starts, dtype=float), robots, WALLS, 0.1)
    return people, stopped_by


def test_two_who_overlap_part_by_half_each():
    people, _ = settled([(0.0, 2.0), (0.7, 2.0)], [(0.05, 2.0), (0.55, 2.0)])
    np.testing.assert_allclose(people[:, :2], [(0.0, 2.0), (0.6, 2.0)], atol=1e-9)


def test_who_stands_is_not_pushed():
    people, _ = settled([(0.0, 2.0), (0.7, 2.0)], [(0.0, 2.0), (0.55, 2.0)], kinds=[at.STANDING, at.ATTENTIVE])
    np.testing.assert_allclose(people[:, :2], [(0.0, 2.0), (0.6, 2.0)], atol=1e-9)


def test_walls_are_not_entered():
    people, _ = settled([(0.0, 0.32)], [(0.1, 0.25)])
    np.testing.assert_allclose(people[0, :2], (0.1, 0.3), atol=1e-9)


def test_who_finds_no_room_stays():
    """Two standing people leave a gap that is too narrow, and push with equal strength from both sides."""
    people, _ = settled([(0.0, 2.0), (1.0, 2.0), (0.5, 2.4)], [(0.0, 2.0), (1.0, 2.0), (0.5, 2.0)], kinds=[2, 2, 0])
    np.testing.assert_array_equal(people[2, :2], (0.5, 2.4))


def test_nobody_is_pushed_faster_than_half_again_the_desired_speed():
    people, _ = settled([(0.0, 2.0), (0.7, 2.0)], [(0.0, 2.0), (0.2, 2.0)], kinds=[at.STANDING, at.ATTENTIVE])
    assert people[1, at.X] == pytest.approx(0.6, abs=1e-9)
    people, _ = settled([(0.0, 2.0)], [(1.0, 2.0)])
    assert people[0, at.X] == pytest.approx(0.15)


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


def test_people_on_fixed_routes_push_others_but_not_into_walls():
    kinds = [at.FIXED_ROUTE, at.ATTENTIVE]
    people, _ = settled([(0.0, 2.0), (0.6, 2.0)], [(0.1, 2.0), (0.6, 2.0)], kinds)
    np.testing.assert_allclose(people[:, :2], [(0.1, 2.0), (0.7, 2.0)], atol=1e-9)
    people, _ = settled([(0.0, 0.9), (0.0, 0.3)], [(0.0, 0.8), (0.0, 0.3)], kinds)
    np.testing.assert_array_equal(people[:, :2], [(0.0, 0.9), (0.0, 0.3)])
