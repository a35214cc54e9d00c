import math

import numpy as np

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation.scan_points import ScanGeometry
from lidarnaut.envs.observations import trajectories as at
from lidarnaut.envs.observations.trajectories import TWISTS
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from tests.rollouts import rollout

COMMANDS = np.float32(at.SPEEDS), np.float32(at.TURNS)
LIMITS = 2.0, 4.0, 5.0, 25.0, 0.3
NOBODY, NOTHING = np.empty((0, 5)), np.empty((2, 0))
CROWD = {"world": "hall", "people": 12, "physics": "kinematic", "contact": "costs", "observations": ("trajectories",)}


def shown(now=(0.0, 0.0), points=NOTHING, people=NOBODY, limits=LIMITS, sees_behind=True):
    out = np.empty((len(TWISTS), at.NUMBERS), dtype=np.float32)
    points, people = np.ascontiguousarray(points, dtype=float), np.asarray(people, dtype=float)
    at.predict_outcomes(now, (*limits, sees_behind), points, people, COMMANDS, out)
    return out


def slow_outcomes(now, points, people, twist):
    """Return the features of a twist by NumPy, with all points and people, shape (8,)."""
    (v, w), x, y, theta = now, 0.0, 0.0, 0.0
    max_v, max_w, acc_v, acc_w, radius = LIMITS
    both, nobody = people[:, 4] + radius, np.array([math.inf])
    reach = min(radius + at.WALL_MARGIN, np.hypot(*points.T).min() - 0.25 * at.WALL_MARGIN)
    least, until_wall, until_person, near_person = math.inf, at.HORIZON, at.HORIZON, 0.0
    for time in np.arange(at.STEP, at.HOLD + 1e-9, at.STEP):
        v += np.clip(twist[0] * max_v - v, -acc_v * at.STEP, acc_v * at.STEP)
        w += np.clip(twist[1] * max_w - w, -acc_w * at.STEP, acc_w * at.STEP)
        turned = theta + 0.5 * w * at.STEP
        x, y = x + v * at.STEP * math.cos(turned), y + v * at.STEP * math.sin(turned)
        theta += w * at.STEP
        away = np.hypot(*(points - (x, y)).T).min()
        until_wall = min(until_wall, time) if away < reach else until_wall
        gap = np.min([*(np.hypot(*(people[:, :2] + time * people[:, 2:4] - (x, y)).T) - both), *nobody])
        until_person = min(until_person, time) if gap < 0.0 else until_person
        near_person = max(near_person, min(1.0, 1.0 - gap / at.NEAR_PERSON) * math.exp(-time / at.DECAY_TIME))
        least = min(least, away)
    v, heading, closest = twist[0] * max_v, np.array([math.cos(theta), math.sin(theta)]), least
    if v != 0.0:
        ahead = (points - (x, y)) @ heading * math.copysign(1.0, v)
        aside = np.abs((points - (x, y)) @ (-heading[1], heading[0]))
        hits = ahead - np.sqrt(np.maximum(reach**2 - aside**2, 0.0))
        hit = np.min([*hits[(ahead > 0.0) & (aside < reach)], *nobody])
        until_wall = min(until_wall, at.HOLD + max(hit, 0.0) / abs(v))
        beyond = np.hypot(aside, np.maximum(ahead - abs(v) * at.LINE_TIME, 0.0))[ahead > 0.0]
        closest = np.min([closest, *beyond])
    for (px, py, *velocity, _), sum_of_radii in zip(people, both, strict=True):
        start, relative = np.array([px, py]) + at.HOLD * np.array(velocity) - (x, y), velocity - v * heading
        if start @ relative < 0.0:
            time = min(-(start @ relative) / (relative @ relative), at.HORIZON - at.HOLD)
            gap = np.hypot(*(start + time * relative)) - sum_of_radii
            closeness = min(1.0, 1.0 - gap / at.NEAR_PERSON)
            near_person = max(near_person, closeness * math.exp(-(at.HOLD + time) / at.DECAY_TIME))
            roots = np.roots([relative @ relative, 2.0 * start @ relative, start @ start - sum_of_radii**2])
            if np.isreal(roots).all() and roots.min() >= 0.0:
                until_person = min(until_person, at.HOLD + roots.min())
    near_wall = min(max(0.0, 1.0 - (closest - reach) / at.NEAR_WALL), 1.0)
    end = (np.array([x, y]) + 0.5 * at.LINE_TIME * v * heading) / (max_v * (at.HOLD + 0.5 * at.LINE_TIME))
    gap = np.clip((least - radius) / at.SMALL_GAP, -1.0, 1.0)
    times = np.array([until_wall, until_person]) / at.HORIZON
    return np.array([*times, near_wall, near_person, *end, theta / math.pi, gap])


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


def test_ends_are_shares_of_what_the_robot_can_drive():
    slow, fast = (shown(limits=(max_v, 4.0, 2.5 * max_v, 25.0, 0.3)) for max_v in (0.3, 2.0))
    np.testing.assert_allclose(slow[:, at.END], fast[:, at.END], atol=1e-6)
    assert (fast[:, :4] == (1.0, 1.0, 0.0, 0.0)).all()


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
    assert at.find_walls(ranges, geometry, NOBODY, points) > 1
    assert at.find_walls(ranges, geometry, np.array([(2.0, 0.0, 1.0, 0.0, 0.3)]), points) == 1
    np.testing.assert_allclose(points[:, 0], (0.0, -1.0), atol=1e-6)
    pillar = np.array([(2.0, 0.0, 0.2, 0.0, 0.3)])
    assert at.find_walls(ranges, geometry, pillar, points) > 1


def test_fine_commands_include_the_others_and_slower_ones():
    seen = []
    for fine in (False, True):
        env = LidarEnv(ReachGoal, **{**CROWD, "observations": {"trajectories": {"fine": fine}}})
        seen.append(list(rollout(env, 2, 15))[-1][0]["trajectories"])
        assert seen[-1].shape == env.observation_space["trajectories"].shape
        np.testing.assert_array_equal(env.observe()["trajectories"], seen[-1])  # looking twice changes nothing
    others = [(np.abs(at.FINE_TWISTS - twist).max(axis=1) == 0.0).argmax() for twist in TWISTS]
    np.testing.assert_allclose(seen[1][others], seen[0], atol=1e-6)
    slowest = np.abs(at.FINE_TWISTS[at.FINE_TWISTS[:, 0] != 0.0, 0]).min()
    assert 0.0 < slowest <= 0.1 * np.abs(TWISTS[TWISTS[:, 0] != 0.0, 0]).min()
