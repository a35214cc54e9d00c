import itertools
import math

import numpy as np
import pytest
from numba import njit
from scipy.optimize import linprog

from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd.orca import Orca, avoid, best_velocity, walk_by_orca
from lidarnaut.envs.simulation.crowd.walls import list_walls
from tests.crowds import NO_ROBOTS, people_at

LIMIT = 1.5


@njit
def line_of(away, own, other, reach, horizon, dt, share):
    lines = np.empty((1, 4))
    avoid(lines, 0, away, own, other, reach, horizon, dt, share)
    return lines[0]


def least_gap(away, velocity, reach, horizon):
    """Minimum distance between two discs within a time [m]; one disc moves by the relative velocity."""
    time = np.clip(away @ velocity / max(velocity @ velocity, 1e-300), 0.0, horizon)
    return np.hypot(*(away - time * velocity)) - reach


def random_pair(rng):
    away = rng.uniform(-3.0, 3.0, 2)
    own, other = rng.uniform(-1.5, 1.5, (2, 2))
    return away, own, other, min(0.65, 0.9 * np.hypot(*away))


def test_the_line_is_the_smallest_change_to_the_edge_of_the_velocity_obstacle():
    rng, horizon = np.random.default_rng(0), 3.0
    angles = np.linspace(0.0, 2.0 * math.pi, 180, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    for _ in range(100):
        away, own, other, reach = random_pair(rng)
        line = line_of(tuple(away), tuple(own), tuple(other), reach, horizon, 0.1, 1.0)
        edge, change = line[:2] - other, line[:2] - own
        assert least_gap(away, edge, reach, horizon) == pytest.approx(0.0, abs=1e-9)
        assert change @ line[2:] == pytest.approx(0.0, abs=1e-9)
        assert np.hypot(*line[2:]) == pytest.approx(1.0)
        # No velocity closer than the edge is on its other side, and velocities to the left are allowed.
        is_free = least_gap(away, own - other, reach, horizon) > 0.0
        nearer = own - other + 0.999 * np.hypot(*change) * around
        assert all((least_gap(away, velocity, reach, horizon) > 0.0) == is_free for velocity in nearer)
        outward = edge + 1e-3 * np.array([-line[3], line[2]])
        assert least_gap(away, outward, reach, horizon) > 0.0


def test_who_overlaps_parts_within_the_step():
    line = line_of((0.5, 0.0), (0.0, 0.0), (0.0, 0.0), 0.6, 5.0, 0.1, 1.0)
    np.testing.assert_allclose(line, (-1.0, 0.0, 0.0, 1.0), atol=1e-12)


def random_lines(rng, count, spread):
    angles, offsets = rng.uniform(-math.pi, math.pi, count), rng.normal(0.3, spread, count)
    along = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.column_stack([offsets[:, None] * np.column_stack([along[:, 1], -along[:, 0]]), along])


def violations(lines, velocity):
    return lines[:, 2] * (lines[:, 1] - velocity[1]) - lines[:, 3] * (lines[:, 0] - velocity[0])


def nearest_allowed(lines, desired):
    """Nearest of all corners: the desired velocity, its feet on lines and circle, and their intersections."""
    corners = [desired, desired * min(1.0, LIMIT / np.hypot(*desired))]
    for x, y, ex, ey in lines:
        foot = (desired - (x, y)) @ (ex, ey)
        middle = -(x * ex + y * ey)
        half = math.sqrt(max(LIMIT**2 - (x * x + y * y - middle * middle), 0.0))
        corners += [np.array((x + along * ex, y + along * ey)) for along in (foot, middle - half, middle + half)]
    for first, second in itertools.combinations(lines, 2):
        matrix = np.column_stack([first[2:], -second[2:]])
        if abs(np.linalg.det(matrix)) > 1e-12:
            corners.append(first[:2] + np.linalg.solve(matrix, second[:2] - first[:2])[0] * first[2:])
    allowed = [v for v in corners if np.hypot(*v) <= LIMIT + 1e-9 and (violations(lines, v) <= 1e-9).all()]
    return min(allowed, key=lambda velocity: np.hypot(*(velocity - desired)), default=None)


def test_the_best_velocity_is_that_of_a_search_over_all_corners():
    rng, counts = np.random.default_rng(1), [0, 0]
    for _ in range(400):
        lines, desired = random_lines(rng, rng.integers(1, 9), 0.6), rng.uniform(-1.3, 1.3, 2)
        expected = nearest_allowed(lines, desired)
        counts[expected is None] += 1
        if expected is not None:
            found = best_velocity(lines, len(lines), 0, tuple(desired), LIMIT)
            np.testing.assert_allclose(found, expected, atol=1e-7)
            assert np.hypot(*(found - desired)) == pytest.approx(np.hypot(*(expected - desired)), abs=1e-9)
    assert min(counts) > 40


def least_violation(lines, num_hard):
    """Minimum depth in soft lines, by linear programming; violated parts of the circle are cut by tangents."""
    normals = np.column_stack([lines[:, 3], -lines[:, 2]])  # forbidden side
    limits = (normals * lines[:, :2]).sum(axis=1)
    soft = (np.arange(len(lines)) >= num_hard).astype(float)
    rows, bounds = np.column_stack([normals, -soft]), limits
    for _ in range(60):
        solution = linprog([0.0, 0.0, 1.0], rows, bounds, bounds=[(-LIMIT, LIMIT), (-LIMIT, LIMIT), (None, None)])
        velocity = solution.x[:2]
        if (speed := np.hypot(*velocity)) <= LIMIT + 1e-11:
            break
        rows = np.vstack([rows, [*velocity / speed, 0.0]])
        bounds = np.append(bounds, LIMIT)
    return solution.x[2]


def test_where_no_velocity_is_allowed_the_least_bad_one_is_taken():
    rng, count = np.random.default_rng(2), 0
    while count < 100:
        lines, num_hard = random_lines(rng, 10, 0.6), rng.integers(0, 3)
        # Hard lines are walls, and allow zero velocity.
        lines[:num_hard] = random_lines(rng, num_hard, 0.0)
        desired = rng.uniform(-1.0, 1.0, 2)
        if nearest_allowed(lines, desired) is not None:
            continue
        count += 1
        found = best_velocity(lines, len(lines), num_hard, tuple(desired), LIMIT)
        depths = violations(lines, found)
        assert np.hypot(*found) <= LIMIT + 1e-9
        assert depths[:num_hard].max(initial=0.0) <= 1e-9
        assert depths[num_hard:].max() == pytest.approx(least_violation(lines, num_hard), abs=1e-7)


NO_WALLS = list_walls(np.empty((0, 4)), np.empty((0, 3)), (-9.0, -9.0, 9.0, 9.0), 0.3)


def velocities(people, ahead, robots=NO_ROBOTS, walls=NO_WALLS, model=Orca()):  # noqa: B008
    before = people[:, :2].copy()
    walk_by_orca(people, np.array(ahead, dtype=float), robots, walls, model, 0.1)
    return (people[:, :2] - before) / 0.1


def meeting():
    return people_at([(-1.5, 0.05), (1.5, -0.05)], [(1, 0), (-1, 0)])


def test_two_who_meet_give_way_alike():
    first, second = velocities(meeting(), [(1, 0), (-1, 0)])
    np.testing.assert_allclose(first, -second, atol=1e-12)
    assert 0.5 < first[0] <= 1.0
    assert first[1] > 0.05


def test_attentive_people_do_all_for_robots_and_blind_people_nothing():
    robots = np.array([(1.5, -0.05, -1.0, 0.0, 0.3)])
    blind, attentive = (
        velocities(people_at([(-1.5, 0.05)], (1, 0), kind), [(1, 0)], robots)[0] for kind in (at.BLIND, at.ATTENTIVE)
    )
    np.testing.assert_allclose(blind, (1.0, 0.0), atol=1e-9)
    halves = velocities(meeting(), [(1, 0), (-1, 0)])[0]
    assert attentive[1] == pytest.approx(2.0 * halves[1], rel=0.1)
    assert attentive[1] > 0.1


def test_only_those_in_sight_count():
    kinds = [at.ATTENTIVE, at.STANDING, at.STANDING]
    crowd = people_at([(0, 0), (1.2, 0.1), (3.5, -0.1)], [(1, 0), (0, 0), (0, 0)], kinds)
    near = velocities(crowd[:2].copy(), [(1, 0)] * 2)[0]
    assert np.hypot(*(near - (1.0, 0.0))) > 0.1
    np.testing.assert_array_equal(velocities(crowd.copy(), [(1, 0)] * 3, model=Orca(sight=3.0))[0], near)
    assert not np.allclose(velocities(crowd.copy(), [(1, 0)] * 3)[0], near)


@pytest.mark.parametrize(
    ("position", "ahead", "expected"),
    [
        ((-1.0, 0.5), (0, 1), (0.0, 0.2 / 0.5)),
        ((0.3, 0.0), (1, 0), (0.2 / 0.5, 0.0)),  # to the cylinder
        ((5.5, 0.5), (0, 1), (0.0, 1.0)),  # past the end of the wall
    ],
)
def test_walls_are_not_walked_into_within_their_horizon(position, ahead, expected):
    wall, cylinder = np.array([(-5.0, 1.0, 5.0, 1.0)]), np.array([(1.0, 0.0, 0.2)])
    walls = list_walls(wall, cylinder, (-5.0, -5.0, 5.0, 5.0), 0.3)
    np.testing.assert_allclose(velocities(people_at([position], ahead), [ahead], walls=walls)[0], expected, atol=1e-9)
