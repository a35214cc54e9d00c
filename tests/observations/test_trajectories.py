import math

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation.scan_points import ScanGeometry
from lidarnaut.envs.observations.trajectories import (
    DECAY_TIME,
    END,
    HOLD,
    HORIZON,
    LINE_TIME,
    NEAR_PERSON,
    NEAR_WALL,
    NUMBERS,
    SMALL_GAP,
    SPEEDS,
    STEP,
    TURN,
    TURNS,
    TWISTS,
    WALL_MARGIN,
    find_walls,
    predict_outcomes,
)
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.vector import LidarVectorEnv
from tests.rollouts import rollout, step_both

COMMANDS = np.float32(SPEEDS), np.float32(TURNS)
LIMITS = 2.0, 4.0, 5.0, 25.0, 0.3
GAP = -1
NOBODY, NOTHING = np.empty((0, 5)), np.empty((2, 0))
CROWD = {"world": "hall", "people": 12, "physics": "kinematic", "contact": "costs", "observations": ("trajectories",)}


def shown(now=(0.0, 0.0), points=NOTHING, people=NOBODY, limits=LIMITS, sees_behind=True):
    out = np.empty((len(TWISTS), NUMBERS), dtype=np.float32)
    predict_outcomes(
        now, (*limits, sees_behind), np.asarray(points, dtype=float), np.asarray(people, dtype=float), COMMANDS, out
    )
    return out


def slow_outcomes(now, points, people, twist):
    """Return the features of a twist by NumPy, with all points and people, shape (8,)."""
    (v, w), x, y, theta = now, 0.0, 0.0, 0.0
    max_v, max_w, acc_v, acc_w, radius = LIMITS
    both, nobody = people[:, 4] + radius, np.array([math.inf])
    reach = min(radius + WALL_MARGIN, np.hypot(*points.T).min() - 0.25 * WALL_MARGIN)
    least, until_wall, until_person, near_person = math.inf, HORIZON, HORIZON, 0.0
    for time in np.arange(STEP, HOLD + 1e-9, STEP):
        v += np.clip(twist[0] * max_v - v, -acc_v * STEP, acc_v * STEP)
        w += np.clip(twist[1] * max_w - w, -acc_w * STEP, acc_w * STEP)
        x, y = x + v * STEP * math.cos(theta + 0.5 * w * STEP), y + v * STEP * math.sin(theta + 0.5 * w * STEP)
        theta += w * STEP
        away = np.hypot(*(points - (x, y)).T).min()
        until_wall = min(until_wall, time) if away < reach else until_wall
        gap = np.min([*(np.hypot(*(people[:, :2] + time * people[:, 2:4] - (x, y)).T) - both), *nobody])
        until_person = min(until_person, time) if gap < 0.0 else until_person
        near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-time / DECAY_TIME))
        least = min(least, away)
    v, heading, closest = twist[0] * max_v, np.array([math.cos(theta), math.sin(theta)]), least
    if v != 0.0:
        ahead = (points - (x, y)) @ heading * math.copysign(1.0, v)
        aside = np.abs((points - (x, y)) @ (-heading[1], heading[0]))
        hits = ahead - np.sqrt(np.maximum(reach**2 - aside**2, 0.0))
        hit = np.min([*hits[(ahead > 0.0) & (aside < reach)], *nobody])
        until_wall = min(until_wall, HOLD + max(hit, 0.0) / abs(v))
        beyond = np.hypot(aside, np.maximum(ahead - abs(v) * LINE_TIME, 0.0))[ahead > 0.0]
        closest = np.min([closest, *beyond])
    for (px, py, *velocity, _), sum_of_radii in zip(people, both, strict=True):
        start, relative = np.array([px, py]) + HOLD * np.array(velocity) - (x, y), velocity - v * heading
        if start @ relative < 0.0:
            time = min(-(start @ relative) / (relative @ relative), HORIZON - HOLD)
            gap = np.hypot(*(start + time * relative)) - sum_of_radii
            near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-(HOLD + time) / DECAY_TIME))
            roots = np.roots([relative @ relative, 2.0 * start @ relative, start @ start - sum_of_radii**2])
            if np.isreal(roots).all() and roots.min() >= 0.0:
                until_person = min(until_person, HOLD + roots.min())
    near_wall = min(max(0.0, 1.0 - (closest - reach) / NEAR_WALL), 1.0)
    end = (np.array([x, y]) + 0.5 * LINE_TIME * v * heading) / (max_v * (HOLD + 0.5 * LINE_TIME))
    gap = np.clip((least - radius) / SMALL_GAP, -1.0, 1.0)
    return np.array([until_wall / HORIZON, until_person / HORIZON, near_wall, near_person, *end, theta / math.pi, gap])


def test_outcomes_equal_those_of_all_points_and_people_one_by_one():
    rng, met, hit = np.random.default_rng(0), 0, 0
    for case in range(60):
        angle, away = rng.uniform(-math.pi, math.pi, 1 + 2 * case), rng.uniform(0.31, 6.0, 1 + 2 * case) ** 1.3
        points = np.column_stack([away * np.cos(angle), away * np.sin(angle)])
        people = np.column_stack([rng.uniform(-3.0, 3.0, (case % 8, 2)), rng.normal(0, 0.8, (case % 8, 2))])
        people = np.column_stack([people, rng.uniform(0.2, 0.4, case % 8)])
        now = rng.uniform(-0.6, 2.0), rng.uniform(-4.0, 4.0)
        found = shown(now, points.T, people)
        expected = [slow_outcomes(now, points, people, twist.astype(float)) for twist in TWISTS]
        np.testing.assert_allclose(found, expected, atol=1e-6)
        met, hit = met + (found[:, 1] < 1.0).sum(), hit + (found[:, 0] < 1.0).sum()
    assert min(met, hit) > 500


def slow_times(now, points, people, twist):
    """Return collision times of a twist with points and people, in steps of 5 ms, inf for never."""
    (v, w), x, y, theta, time, dt = now, 0.0, 0.0, 0.0, 0.0, STEP
    max_v, max_w, acc_v, acc_w, radius = LIMITS
    wall = person = math.inf
    while time < HORIZON - 1e-9:
        if time < HOLD - 1e-9:
            v += np.clip(twist[0] * max_v - v, -acc_v * dt, acc_v * dt)
            w += np.clip(twist[1] * max_w - w, -acc_w * dt, acc_w * dt)
        else:
            v, w, dt = twist[0] * max_v, 0.0, 0.005
        x, y = x + v * dt * math.cos(theta + 0.5 * w * dt), y + v * dt * math.sin(theta + 0.5 * w * dt)
        theta, time = theta + w * dt, time + dt
        ahead = (
            points
            if time <= HOLD + 1e-9
            else points[(points - (x, y)) @ (v * math.cos(theta), v * math.sin(theta)) > 0]
        )
        if len(ahead) and np.hypot(*(ahead - (x, y)).T).min() < radius + WALL_MARGIN:
            wall = min(wall, time)
        if (np.hypot(*(people[:, :2] + time * people[:, 2:4] - (x, y)).T) < people[:, 4] + radius).any():
            person = min(person, time)
    return wall, person


def test_times_to_contact_are_those_of_small_steps():
    rng = np.random.default_rng(0)
    for _ in range(4):
        angle, away = rng.uniform(-math.pi, math.pi, 8), rng.uniform(0.6, 4.0, 8)
        points = np.column_stack([away * np.cos(angle), away * np.sin(angle)])
        people = np.column_stack(
            [rng.uniform(1.0, 3.0, 5), rng.uniform(-2.0, 2.0, 5), rng.normal(0, 1, (5, 2)), np.full(5, 0.3)]
        )
        now = 1.0, 0.4
        found = shown(now, points.T, people)
        for twist, row in zip(TWISTS, found, strict=True):
            wall, person = slow_times(now, points, people, twist)
            assert row[0] * HORIZON == pytest.approx(min(wall, HORIZON), abs=0.03)
            assert row[1] * HORIZON == pytest.approx(min(person, HORIZON), abs=0.03)


def test_who_walks_beside_the_robot_is_near_and_is_not_met():
    ahead = int(np.flatnonzero((TWISTS == (1.0, 0.0)).all(axis=1))[0])
    straight = shown((2.0, 0.0), people=[(0.0, 0.8, 2.0, 0.0, 0.3)])[ahead]
    assert straight[1] == 1.0
    assert 0.5 < straight[3] < 1.0
    np.testing.assert_allclose(straight[END], (1.0, 0.0), atol=1e-6)
    head_on = shown((2.0, 0.0), people=[(3.0, 0.0, -1.0, 0.0, 0.3)])[ahead]
    assert head_on[1] * HORIZON == pytest.approx(2.4 / 3.0, abs=1e-3)
    assert (shown()[:, :4] == (1.0, 1.0, 0.0, 0.0)).all()


def test_gaps_say_by_how_little_a_passage_is_wide_enough():
    for half_width, gap in ((0.35, 0.05), (0.27, -0.03)):
        points = [(x, y) for x in np.linspace(0.0, 3.0, 61) for y in (-half_width, half_width)]
        found = shown((1.0, 0.0), np.array(points).T)[(TWISTS == (0.65, 0.0)).all(axis=1), GAP]
        assert found * SMALL_GAP == pytest.approx(gap, abs=1e-3)


def test_left_and_right_turns_on_the_spot_can_be_told_apart():
    left, right = (shown()[(np.abs(TWISTS - (0.0, w)) < 1e-6).all(axis=1)][0] for w in (0.4, -0.4))
    assert left[TURN] * math.pi == pytest.approx(0.4 * 4.0 * HOLD, abs=1e-5)
    assert left[TURN] == -right[TURN]


def test_ends_are_shares_of_what_the_robot_can_drive():
    slow, fast = (shown(limits=(max_v, 4.0, 2.5 * max_v, 25.0, 0.3)) for max_v in (0.3, 2.0))
    np.testing.assert_allclose(slow[:, END], fast[:, END], atol=1e-6)


def test_backwards_is_blocked_where_the_lidar_does_not_see():
    seen, unseen = shown(sees_behind=True), shown(sees_behind=False)
    backwards = TWISTS[:, 0] < 0.0
    np.testing.assert_array_equal(seen[~backwards], unseen[~backwards])
    assert (seen[backwards, 0] == 1.0).all()
    assert (unseen[backwards][:, [0, 2]] == (0.0, 1.0)).all()
    for robot, is_seen in (("jackal", False), ("turtlebot3_waffle_pi", True)):
        env = LidarEnv(ReachGoal, **{**CROWD, "world": "clutter", "people": 0, "robot": robot})
        observation, _ = env.reset(seed=0)
        assert (observation["trajectories"][backwards, 0] > 0.0).any() == is_seen


def test_points_on_who_walks_are_no_walls():
    angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    geometry = ScanGeometry(np.array([np.cos(angles), np.sin(angles)]), 0.0, 0.0, 12.0)
    ranges = np.full(360, np.inf, dtype=np.float32)
    ranges[170:190], ranges[90] = 1.7, 1.0
    points = np.empty((2, 120))
    assert find_walls(ranges, geometry, NOBODY, points) > 1
    assert find_walls(ranges, geometry, np.array([(2.0, 0.0, 1.0, 0.0, 0.3)]), points) == 1
    np.testing.assert_allclose(points[:, 0], (0.0, -1.0), atol=1e-6)
    pillar = np.array([(2.0, 0.0, 0.2, 0.0, 0.3)])
    assert find_walls(ranges, geometry, pillar, points) > 1


def test_to_be_written_twice_changes_nothing():
    env = LidarEnv(ReachGoal, **CROWD)
    for step in rollout(env, 2, 15):
        assert step[0]["trajectories"].shape == (len(TWISTS), NUMBERS)
    np.testing.assert_array_equal(env.observe()["trajectories"], env.observe()["trajectories"])


def test_vector_environments_show_the_same():
    ours = LidarVectorEnv(LidarEnv, 3, task=ReachGoal, **CROWD)
    theirs = SyncVectorEnv([lambda: LidarEnv(ReachGoal, **CROWD)] * 3)
    rng = np.random.default_rng(0)
    for _ in step_both(ours, theirs, rng.uniform(-1, 1, (25, 3, 2)).astype(np.float32)):
        pass
    ours.close()
    theirs.close()
