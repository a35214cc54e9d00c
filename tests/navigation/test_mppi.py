import math

import numpy as np

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.geometry.lines import lengths_along
from lidarnaut.envs.navigation.controllers import mppi
from lidarnaut.envs.navigation.controllers.mppi import MppiParams, MppiPlanner
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist
from tests.navigation.driving import NOTHING, PERIOD, drive, path_through
from tests.rooms import ORIGIN

JACKAL = load_robot("jackal")
STRAIGHT = path_through([0.0, 0.0], [8.0, 0.0])


def planner_of(seed=0, **params):
    """Planner with a path of 8 m straight ahead."""
    planner = MppiPlanner(JACKAL, PERIOD, np.random.default_rng(seed), MppiParams(**params))
    planner.set_path(STRAIGHT)
    return planner


def reference_cost(controls, mean, now, path, points, tracks, p):
    """Cost of one sequence, step by step, with exact distances from points."""
    x = y = theta = cost = away = left = turned = 0.0
    v, w = now
    nearest = 0
    for t, (v_asked, w_asked) in enumerate(controls):
        v += np.clip(v_asked - v, -p.max_acc_v * p.period, p.max_acc_v * p.period)
        w += np.clip(w_asked - w, -p.max_acc_w * p.period, p.max_acc_w * p.period)
        x += v * p.period * math.cos(theta + 0.5 * w * p.period)
        y += v * p.period * math.sin(theta + 0.5 * w * p.period)
        theta += w * p.period
        turned += abs(w)
        cost += p.reverse * p.period * max(-v, 0.0) / p.max_v
        stds = np.array([p.v_std * p.max_v, p.w_std * p.max_w])
        cost += p.gamma * float((mean[t] * (controls[t] - mean[t]) / stds**2).sum())
        gap = np.hypot(*(points - (x, y)).T).min() - p.radius
        if gap < 0.5 * p.resolution:
            return math.inf
        cost += p.nearness * p.period * max(0.0, 1.0 - gap / p.margin) ** 2
        time = (t + 1) * p.period
        for px, py, vx, vy, radius in tracks:
            gap = math.hypot(px + time * vx - x, py + time * vy - y) - radius - p.radius
            cost += p.people * p.period * max(0.0, 1.0 - max(gap, 0.0) / p.people_margin) ** 2
            cost += p.people_touched * math.exp(-time / p.doubt_time) * (gap < p.people_gap + p.headway * abs(v))
        gaps = np.hypot(*(path - (x, y)).T)
        while nearest < len(path) - 1 and gaps[nearest + 1] <= gaps[nearest]:
            nearest += 1
        away += gaps[nearest]
        left += lengths_along(path)[-1] - lengths_along(path)[nearest] + gaps[nearest]
    cost += (p.follow * left / p.max_v + p.align * away + p.twirl * turned) / len(controls)
    to_path = path[min(nearest + 10, len(path) - 1)] - (x, y)
    if math.hypot(*to_path) > mppi.HEADING_RADIUS:
        cost += p.angle * abs(wrap_angle(math.atan2(to_path[1], to_path[0]) - theta))
    return cost


def test_sequences_cost_what_the_reference_says():
    rng = np.random.default_rng(3)
    p, num_steps = mppi.mppi_numbers(JACKAL, PERIOD, MppiParams()), 20
    controls = rng.uniform((0.0, -2.0), (1.5, 2.0), (40, num_steps, 2))
    mean = rng.uniform((0.0, -1.0), (1.0, 1.0), (num_steps, 2))
    path = path_through([0.0, 0.0], [1.0, 0.2], [1.6, 0.8])
    cells = np.array([[140, 65], [165, 125]])
    is_occupied = np.zeros((181, 181), dtype=bool)
    is_occupied[cells[:, 1], cells[:, 0]] = True
    points = p.resolution * (cells - 90.0)
    tracks = np.array([[2.0, 1.5, -1.0, -0.8, 0.3], [1.0, -2.0, 0.3, 1.2, 0.25]])
    costs = np.empty(len(controls))
    squared = squared_distances(is_occupied, 30)
    now = (0.4, 0.3)
    mppi.rate(controls, mean, now, path, lengths_along(path), squared, tracks, p, costs)
    expected = [reference_cost(one, mean, now, path, points, tracks, p) for one in controls]
    touches = np.isinf(expected)
    assert 0 < touches.sum() < len(controls)
    # The diagonal of a cell may decide whether a sequence has a contact.
    agree = touches == (costs >= mppi.COLLISION_COST)
    assert agree.mean() >= 0.9
    free = agree & ~touches
    np.testing.assert_allclose(costs[free], np.array(expected)[free], rtol=0.02, atol=0.1)


def disc(x):
    """Return points on a disc ahead of the robot, like the scan of a person."""
    angles = np.linspace(0.0, 2.0 * math.pi, 60)
    return np.array([x, 0.0]) + 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])


def test_people_are_passed_where_they_will_not_be():
    # A person crosses on a collision course with the robot at x = 4 m.
    start, velocity, radius = (4.0, -2.6), (0.0, 1.3), 0.3
    gaps = []
    for params in ({}, {"people": 0.0, "people_touched": 0.0}):
        poses = np.array(drive(planner_of(**params), JACKAL, ORIGIN, 80, people=[(*start, *velocity, radius)]))
        person = start + PERIOD * np.arange(81)[:, None] * velocity
        gaps.append(np.hypot(*(person - poses[:, :2]).T).min() - radius - JACKAL.radius)
        assert gaps[0] < 0.0 or math.dist(poses[-1, :2], (8.0, 0.0)) < 0.3
    assert gaps[1] < 0.0 < 0.05 < gaps[0]


def test_the_points_of_people_are_no_walls():
    def mean_speed(tracks):
        speeds = []
        for seed in range(4):
            planner = planner_of(seed)
            for _ in range(5):
                planner.tracks = tracks
                twist = planner.command(ORIGIN, Twist(0.5, 0.0), disc(1.5))
            speeds.append(twist.v)
        return np.mean(speeds)

    assert mean_speed(np.array([[1.5, 0.0, 1.5, 0.0, 0.3]])) > mean_speed(np.empty((0, 5))) + 0.1


def test_the_robot_can_stop_short_of_what_the_scan_shows_whatever_is_predicted():
    gap, planner = 0.4, planner_of()
    x = JACKAL.radius + gap + 0.3
    planner.tracks = np.array([[x, 0.0, 4.0, 0.0, 0.3]])
    v, w = planner.command(ORIGIN, Twist(2.0, 0.0), disc(x))
    stopping = v * PERIOD + 0.5 * v * v / (MppiParams().braking * JACKAL.max_acc_v)
    assert 0.5 * gap < stopping < gap + 0.03
    assert abs(w) < 1.0
    planner.tracks = np.empty((0, 5))
    assert planner.command(ORIGIN, Twist(2.0, 0.0), NOTHING).v > v + 0.2


def test_the_same_generator_gives_the_same_commands_and_blocked_says_that_nothing_is_free():
    planners = planner_of(seed=5), planner_of(seed=5)
    first, second = (planner.command(Pose2D(0.0, 0.1, 0.2), Twist(0.5, 0.0), NOTHING) for planner in planners)
    assert first == second
    planner = planners[0]
    assert not planner.blocked
    wall = np.column_stack([np.full(201, JACKAL.radius + 0.03), np.linspace(-1.0, 1.0, 201)])
    assert planner.command(ORIGIN, Twist(2.0, 0.0), wall) == (0.0, 0.0)
    assert planner.blocked
