from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.simulation.crowd import Crowd, People
from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd.step import with_people
from lidarnaut.envs.worlds import FixedRoute
from tests.crowds import (
    CORRIDOR,
    DOORWAY,
    FAR_AWAY,
    HALL,
    PERIOD,
    SCENES,
    begin,
    people_at,
    robots_at_poses,
    walk,
    watch,
)
from tests.rooms import make_room


@pytest.fixture(params=["social_force", "orca"])
def model(request):
    return request.param


@pytest.mark.parametrize("scene", SCENES)
def test_nobody_is_in_a_wall_or_in_somebody_in_250_000_steps(scene, model):
    world, crowd = SCENES[scene]
    people = begin(world, replace(crowd, model=model))
    robots = robots_at_poses(FAR_AWAY)
    periods = 250_000 // len(people.rows)
    overlap, in_wall, slow = watch(*people.arrays, robots, world.segments, world.circles, periods)
    assert overlap <= 0.02
    assert in_wall <= 1e-5
    assert slow <= 4.6
    assert people.rows[:, at.TRIP].min() > periods / 10 / 60  # more than one a minute


def test_people_walk_at_about_their_desired_speed(model):
    people = begin(HALL, Crowd(number=10, model=model, speed=(0.8, 1.2)))
    rows = walk(people, 600)
    speeds = np.hypot(rows[..., at.VX], rows[..., at.VY])
    assert 0.8 < (speeds / rows[..., at.SPEED]).mean() < 1.05
    assert (speeds <= 1.5 * rows[..., at.SPEED]).all()


def test_everybody_gets_through_a_door_that_lets_one_pass(model):
    people = begin(DOORWAY, Crowd(number=8, model=model, flow="along"))
    side = np.sign(walk(people, 1500)[..., at.X])
    crossings = (side[1:] != side[:-1]).sum(axis=0)
    assert crossings.min() >= 2
    assert crossings.sum() >= 40


@pytest.mark.parametrize("attentive", [0.0, 1.0])
def test_attentive_people_give_way_to_robots_and_blind_people_do_not(model, attentive):
    crowd = Crowd(number=6, model=model, attentive=attentive)
    alone = walk(begin(HALL, crowd), 100)
    beside = walk(begin(HALL, crowd), 100, robots_at_poses((0.0, 0.0, 0.0, 0.0)))
    touches = (beside[..., at.BLOCKED] > 0.0).any(axis=1)
    if attentive:
        assert not np.allclose(alone, beside)
        assert not touches.any()
    else:
        first = touches.argmax()
        assert first > 0
        np.testing.assert_array_equal(alone[:first], beside[:first])


def test_standing_people_stand_and_others_walk_around_them(model):
    people = begin(CORRIDOR, Crowd(number=8, model=model, standing=0.4, flow="along"), seed=2)
    stands = people.rows[:, at.KIND] == at.STANDING
    assert 0 < stands.sum() < 8
    rows = walk(people, 600)
    assert (np.ptp(rows[:, stands, at.X], axis=0) == 0.0).all()
    assert (np.ptp(rows[:, ~stands, at.X], axis=0) > 10.0).all()


def test_the_fast_and_thin_do_not_get_through_walls():
    """At 6 m/s they would cross a wall before the first contact."""
    halves = make_room(-2, -2, 2, 2, [(0, -2, 0, 2)], spawn=Pose2D(-1.0, 0.0, 0.0))
    people = begin(halves, Crowd(number=8, speed=(5.0, 5.0), radius=(0.1, 0.1)))
    for _ in range(20):
        people.rows[:, at.VX], people.rows[:, at.VY] = 6.0, 0.0
        assert (walk(people, 1)[..., at.X] <= -0.1 + 1e-5).all()


@pytest.mark.parametrize(
    "waypoints", [[(0, 0), (0, 0), (1, 0)], [(0, 0), (1, 0), (0, 0)], [(0, 0), (1, 0), (1, 0), (1, 0)]]
)
@pytest.mark.parametrize("speed", [1e-300, 0.5, 100.0])
def test_people_pass_repeated_points_of_a_route(waypoints, speed):
    people = People()
    people.reset(replace(HALL, people=(FixedRoute(0.3, waypoints, speed),)), (), 0.3, None)
    rows = walk(people, 50)
    travelled = speed * PERIOD * np.arange(1, 51) % 2.0
    np.testing.assert_allclose(rows[:, 0, at.X], np.minimum(travelled, 2.0 - travelled), atol=1e-6)


def test_a_route_that_loses_its_length_later_stops_the_person():
    people = People()
    people.reset(replace(HALL, people=(FixedRoute(0.3, [(0, 0), (1, 0)], 0.5),)), (), 0.3, None)
    people.points[:, :2] = 0.0
    assert walk(people, 3)[-1, 0, at.X] == 0.0


def test_people_are_discs_or_pairs_of_legs():
    people, pillar = people_at([(1.0, 2.0), (3.0, 2.0)]), np.array([(0.0, 0.0, 0.5)])
    people[:, at.HEADING], people[:, at.PHASE] = np.pi / 2, (0.0, np.pi / 2)
    discs = with_people(pillar, people, 0.0)
    np.testing.assert_array_equal(discs, [*pillar, (1.0, 2.0, 0.3), (3.0, 2.0, 0.3)])
    legs = [(1.1, 2.0, 0.06), (0.9, 2.0, 0.06), (3.1, 1.825, 0.06), (2.9, 2.175, 0.06)]
    np.testing.assert_allclose(with_people(pillar, people, 1.0), [*pillar, *legs], atol=1e-12)
