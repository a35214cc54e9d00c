import heapq
import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd import routes as routes_of
from lidarnaut.envs.simulation.crowd.routes import ARRIVAL_DISTANCE, choose_directions, descent, plan_routes
from lidarnaut.envs.worlds import load_world
from tests.crowds import CORRIDOR, DOORWAY, HALL, people_at
from tests.rooms import make_room


def shortest(slowness, source):
    """Cost-to-go by Dijkstra with straight, diagonal and knight's moves; at most 3 % above the exact cost."""
    moves = [(a, b) for a in range(-2, 3) for b in range(-2, 3) if math.gcd(a, b) == 1]
    costs, queue = {source: 0.0}, [(0.0, source)]
    while queue:
        cost, (row, col) = heapq.heappop(queue)
        if cost > costs[row, col]:
            continue
        for a, b in moves:
            cell = row + a, col + b
            if 0 <= cell[0] < slowness.shape[0] and 0 <= cell[1] < slowness.shape[1] and slowness[cell] < np.inf:
                mean = 0.5 * (slowness[row, col] + slowness[cell])
                further = cost + routes_of.RESOLUTION * math.hypot(a, b) * mean
                if further < costs.get(cell, np.inf):
                    costs[cell] = further
                    heapq.heappush(queue, (further, cell))
    return costs


def test_costs_agree_with_dijkstra():
    slowness = np.ones((40, 50), dtype=np.float32)
    slowness[[0, -1]] = slowness[:, [0, -1]] = np.inf
    slowness[:25, 20:22] = slowness[10:, 35:37] = np.inf
    slowness[28:35, 5:15] = 1.5
    field = np.full(slowness.shape, np.inf, dtype=np.float32)
    field[5, 5] = 0.0
    routes_of.spread_costs(slowness, field)
    for cell, cost in shortest(slowness, (5, 5)).items():
        assert field[cell] == pytest.approx(cost, rel=0.05, abs=0.15)
    assert np.isinf(field[slowness == np.inf]).all()


def test_open_halls_are_crossed_straight():
    routes = plan_routes(HALL, 0.3, "anywhere")
    for x, y in np.random.default_rng(0).uniform(-4.9, 4.9, (200, 2)):
        for k, (goal_x, goal_y, _) in enumerate(routes.points):
            distance = math.hypot(goal_x - x, goal_y - y)
            ahead_x, ahead_y, cost = descent(routes.fields, k, routes.walls.grid, x, y)
            if distance > ARRIVAL_DISTANCE:
                assert ahead_x * (goal_x - x) + ahead_y * (goal_y - y) > 0.99 * distance
                assert cost == pytest.approx(distance, abs=0.1)


def test_destinations_are_far_apart_and_each_is_reached_from_everywhere_without_touching_a_wall():
    for world in (HALL, DOORWAY, load_world("turtlebot3_house")):
        routes = plan_routes(world, 0.3, "anywhere")
        assert len(routes.points) == 8
        apart = np.hypot(*(routes.points[:, None, :2] - routes.points[:, :2]).T) + 9.0 * np.eye(8)
        assert apart.min() > 1.0
        rng = np.random.default_rng(0)
        for x, y in routes.room[rng.integers(len(routes.room), size=50)]:
            k = rng.integers(8)
            for _ in range(3000):
                ahead_x, ahead_y, cost = descent(routes.fields, k, routes.walls.grid, x, y)
                if cost < ARRIVAL_DISTANCE:
                    break
                x, y = x + 0.02 * ahead_x, y + 0.02 * ahead_y
            assert cost < ARRIVAL_DISTANCE


def test_flows_lead_to_the_other_end_or_side():
    routes = plan_routes(CORRIDOR, 0.3, "along")
    np.testing.assert_array_equal(routes.points[:, 2], [1, 0])
    assert abs(routes.points[0, 0] - routes.points[1, 0]) > 18.0
    routes = plan_routes(HALL, 0.3, "across")
    np.testing.assert_array_equal(routes.points[:, 2], [1, 0, 3, 2])
    for k, axis in enumerate((1, 1, 0, 0)):
        assert abs(routes.points[k, axis]) > 5.0
        assert routes.points[k, axis] == pytest.approx(-routes.points[k ^ 1, axis], abs=0.3)


def person_to(goal, x, y):
    person = people_at([(x, y)])
    person[0, at.GOAL], person[0, at.DRAWS :] = goal, np.linspace(0.0, 0.99, at.NUM_DRAWS)
    return person


def test_who_arrives_takes_the_next_goal_by_its_own_draws():
    routes = plan_routes(HALL, 0.3, "anywhere")
    goals, directions = [0], np.zeros((1, 2))
    assert (routes.points[:, 2] == routes_of.NEXT_BY_DRAW).all()
    points = np.vstack([np.zeros((2, 3)), routes.points])  # two points of fixed routes come first
    for trip in range(100):
        people = person_to(goals[-1] + 2, *routes.points[goals[-1], :2])
        people[0, at.TRIP] = trip
        choose_directions(people, points, routes.fields, routes.walls.grid, 0.05, directions)
        assert people[0, at.TRIP] == trip + 1
        assert people[0, at.GOAL] != goals[-1] + 2
        assert np.hypot(*directions[0]) == pytest.approx(1.0)
        goals.append(int(people[0, at.GOAL]) - 2)
    assert set(goals) == set(range(8))


def test_who_gets_nowhere_takes_another_goal_after_some_seconds():
    routes = plan_routes(CORRIDOR, 0.3, "along")
    people, directions, times = person_to(0, 0.0, 0.0), np.zeros((1, 2)), []
    for k in range(2000):
        choose_directions(people, routes.points, routes.fields, routes.walls.grid, 0.05, directions)
        if people[0, at.TRIP] == len(times) + 1:
            times.append(0.05 * k)
    waits = np.diff(times)
    assert len(waits) > 20
    assert 1.4 < waits.min() < waits.max() < 4.6
    assert abs(waits.mean() - 3.0) < 1.0


def test_who_gets_nowhere_turns_back_where_a_destination_lies_behind():
    routes = plan_routes(CORRIDOR, 0.3, "anywhere")
    for goal in range(8):
        people, ways = person_to(goal, 1.5, 0.0), np.zeros((1, 2))
        choose_directions(people, routes.points, routes.fields, routes.walls.grid, 0.05, ways)
        before = ways[0].copy()
        for draw in np.linspace(0.0, 0.99, 5):
            people[0, at.DRAWS :], people[0, at.SLOW], people[0, at.GOAL] = draw, 10.0, goal
            choose_directions(people, routes.points, routes.fields, routes.walls.grid, 0.05, ways)
            assert ways[0] @ before < 0.0


def test_who_is_outside_of_everything_walks_nowhere():
    routes = plan_routes(HALL, 0.3, "anywhere")
    assert descent(routes.fields, 0, routes.walls.grid, 100.0, 0.0) == (0.0, 0.0, np.inf)


def test_a_world_in_which_nobody_fits_is_named():
    shaft = make_room(0.0, 0.0, 0.5, 0.5, spawn=Pose2D(0.25, 0.25, 0.0))
    with pytest.raises(ValueError, match=r"world 'test' has no room for people of a radius of 0\.3 m"):
        plan_routes(shaft, 0.3, "anywhere")
