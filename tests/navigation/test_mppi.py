import math

import numpy as np

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.geometry.lines import lengths_along, resample
from lidarnaut.envs.navigation.controllers.mppi import (
    COLLISION_COST,
    HEADING_RADIUS,
    MppiParams,
    MppiPlanner,
    mppi_numbers,
    rate,
)
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist

JACKAL = load_robot("jackal")
PERIOD = 0.1
NOTHING, NO_TRACKS = np.empty((0, 2)), np.empty((0, 5))


def planner_of(robot=JACKAL, seed=0, **params):
    return MppiPlanner(robot, PERIOD, np.random.default_rng(seed), MppiParams(**params))


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
    if math.hypot(*to_path) > HEADING_RADIUS:
        cost += p.angle * abs(wrap_angle(math.atan2(to_path[1], to_path[0]) - theta))
    return cost


def test_sequences_cost_what_the_reference_says():
    rng = np.random.default_rng(3)
    p, num_steps = mppi_numbers(JACKAL, PERIOD, MppiParams()), 20
    controls = rng.uniform((0.0, -2.0), (1.5, 2.0), (40, num_steps, 2))
    mean = rng.uniform((0.0, -1.0), (1.0, 1.0), (num_steps, 2))
    path = resample(np.array([[0.0, 0.0], [1.0, 0.2], [1.6, 0.8]]), 0.05)
    cells = np.array([[140, 65], [165, 125]])
    is_occupied = np.zeros((181, 181), dtype=bool)
    is_occupied[cells[:, 1], cells[:, 0]] = True
    points = p.resolution * (cells - 90.0)
    tracks = np.array([[2.0, 1.5, -1.0, -0.8, 0.3], [1.0, -2.0, 0.3, 1.2, 0.25]])
    costs = np.empty(len(controls))
    squared = squared_distances(is_occupied, 30)
    now = (0.4, 0.3)
    rate(controls, mean, now, path, lengths_along(path), squared, tracks, p, costs)
    expected = [reference_cost(one, mean, now, path, points, tracks, p) for one in controls]
    touches = np.isinf(expected)
    assert 0 < touches.sum() < len(controls)
    # The diagonal of a cell may decide whether a sequence has a contact.
    agree = touches == (costs >= COLLISION_COST)
    assert agree.mean() >= 0.9
    free = agree & ~touches
    np.testing.assert_allclose(costs[free], np.array(expected)[free], rtol=0.02, atol=0.1)


def drive(planner, robot, path, num_steps, people=(), walls=NOTHING):
    """Follow a path; return the poses and the minimum gap to people.

    `people`: rows of `tracks` in the map frame.
    """
    planner.set_path(path)
    pose, v, w, gap, poses = Pose2D(*path[0], 0.0), 0.0, 0.0, math.inf, []
    people = np.array(people, dtype=np.float64).reshape(-1, 5)
    for _ in range(num_steps):
        turned = Pose2D(0.0, 0.0, -pose.theta)
        planner.tracks = np.column_stack(
            [pose.inverse().transform(people[:, :2]), turned.transform(people[:, 2:4]), people[:, 4]]
        )
        command = planner.command(pose, Twist(v, w), pose.inverse().transform(walls) if len(walls) else walls)
        v += float(np.clip(command.v - v, -robot.max_acc_v * PERIOD, robot.max_acc_v * PERIOD))
        w += float(np.clip(command.w - w, -robot.max_acc_w * PERIOD, robot.max_acc_w * PERIOD))
        pose = pose.compose(Pose2D(v * PERIOD, 0.0, w * PERIOD))
        people[:, :2] += PERIOD * people[:, 2:4]
        if len(people):
            gap = min(gap, float((np.hypot(*(people[:, :2] - pose[:2]).T) - people[:, 4]).min()) - robot.radius)
        poses.append(pose)
    return poses, gap


STRAIGHT = resample(np.array([[0.0, 0.0], [8.0, 0.0]]), 0.05)


def test_people_are_passed_where_they_will_not_be():
    # A person crosses on a collision course with the robot at x = 4 m.
    crossing = [(4.0, -2.6, 0.0, 1.3, 0.3)]
    poses, gap = drive(planner_of(), JACKAL, STRAIGHT, 80, crossing)
    assert gap > 0.05
    assert math.hypot(poses[-1].x - 8.0, poses[-1].y) < 0.3
    blind = planner_of(people=0.0, people_touched=0.0)
    assert drive(blind, JACKAL, STRAIGHT, 80, crossing)[1] < 0.0


def test_the_points_of_people_are_no_walls():
    angles = np.linspace(0.0, 2.0 * math.pi, 30)
    body = np.array([2.0, 0.0]) + 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    leaving = np.array([[2.0, 0.0, 1.5, 0.0, 0.3]])
    speeds = []
    for tracks in (NO_TRACKS, leaving):
        planner = planner_of()
        planner.set_path(STRAIGHT)
        for _ in range(5):
            planner.tracks = tracks
            twist = planner.command(Pose2D(0.0, 0.0, 0.0), Twist(1.0, 0.0), body)
        speeds.append(twist.v)
    assert speeds[1] > speeds[0] + 0.05


def test_the_robot_can_stop_short_of_what_the_scan_shows_whatever_is_predicted():
    angles, gap, params = np.linspace(0.0, 2.0 * math.pi, 60), 0.4, MppiParams()
    x = JACKAL.radius + gap + 0.3
    body = np.array([x, 0.0]) + 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    planner = planner_of()
    planner.set_path(STRAIGHT)
    planner.tracks = np.array([[x, 0.0, 4.0, 0.0, 0.3]])
    v, w = planner.command(Pose2D(0.0, 0.0, 0.0), Twist(2.0, 0.0), body)
    stopping = v * PERIOD + 0.5 * v * v / (params.braking * JACKAL.max_acc_v)
    assert 0.5 * gap < stopping < gap + 0.03
    assert abs(w) < 1.0
    planner.tracks = NO_TRACKS
    assert planner.command(Pose2D(0.0, 0.0, 0.0), Twist(2.0, 0.0), NOTHING).v > v + 0.2


def test_the_same_generator_gives_the_same_commands_and_blocked_says_that_nothing_is_free():
    twists = []
    for _ in range(2):
        planner = planner_of(seed=5)
        planner.set_path(STRAIGHT)
        twists.append(planner.command(Pose2D(0.0, 0.1, 0.2), Twist(0.5, 0.0), NOTHING))
        assert not planner.blocked
    assert twists[0] == twists[1]
    wall = np.column_stack([np.full(201, JACKAL.radius + 0.03), np.linspace(-1.0, 1.0, 201)])
    assert planner.command(Pose2D(0.0, 0.0, 0.0), Twist(2.0, 0.0), wall) == (0.0, 0.0)
    assert planner.blocked
