import math

import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.observations.scan_history import MAX_FILL_SECTORS, SURFACE_STEP, Sectors, pool_scan, shift_sectors
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from tests.rollouts import rollout

ROOM = {"world": "turtlebot3_world", "physics": "kinematic", "contact": "costs"}


def histories(steps, **settings):
    env = LidarEnv(ReachGoal, **ROOM, observations={"scan_history": settings, "scan": None})
    return env, [step[0] for step in rollout(env, 1, steps)]


def test_scans_are_pooled_to_the_least_range_of_each_sector():
    scan = np.array([2.0, 1.0, np.nan, 3.0, np.inf, np.inf, np.nan, np.nan, 0.5, np.inf], dtype=np.float32)
    sectors = np.empty(5, dtype=np.float32)
    pool_scan(scan, np.arange(0, 11, 2), sectors)
    np.testing.assert_array_equal(sectors, np.float32([1.0, 3.0, np.inf, 0.0, 0.5]))
    sectors = np.empty(3, dtype=np.float32)
    pool_scan(scan, np.array([0, 3, 6, 10]), sectors)
    np.testing.assert_array_equal(sectors, np.float32([1.0, 3.0, 0.5]))


def test_ranges_are_shown_finely_where_obstacles_are_near():
    env, (first, *_) = histories(0, lags=(0.0,), num_sectors=360)
    ranges, radius = env.robots[0].ranges, env.robot_params.radius
    expected = 0.5 / (np.maximum(ranges - radius, 0.0) + 0.5)
    np.testing.assert_allclose(first["scan_history"], np.where(np.isnan(ranges), 1.0, expected), atol=1e-6)


def test_past_scans_are_those_of_before_up_to_a_limit():
    with pytest.raises(ValueError, match="1000 control periods"):
        histories(0, lags=(0.0, 200.0))
    _, seen = histories(12, lags=(0.0, 0.1, 0.5), compensate=False)
    for k, observation in enumerate(seen):
        now, before, long_before = observation["scan_history"].reshape(3, 90)
        np.testing.assert_array_equal(before, seen[max(k - 1, 0)]["scan_history"][:90])
        np.testing.assert_array_equal(long_before, seen[max(k - 5, 0)]["scan_history"][:90])
        assert k == 0 or (now != before).any()


def slow_shift(ranges, motion, sectors):
    """Transform the points of sectors one by one, including straight lines between neighbours on one surface."""
    count, turn = len(ranges), 2.0 * math.pi
    (x, y, theta), seen, whole = motion, np.full(len(ranges), np.inf), turn * sectors.per_radian
    c, s = math.cos(sectors.yaw), math.sin(sectors.yaw)
    polar = []
    for r, dx, dy in zip(np.minimum(ranges, 1e6), *sectors.directions, strict=True):
        px, py = sectors.x + r * (c * dx - s * dy) - x, sectors.y + r * (s * dx + c * dy) - y
        px, py = math.cos(theta) * px + math.sin(theta) * py, math.cos(theta) * py - math.sin(theta) * px
        px, py = px - sectors.x, py - sectors.y
        px, py = c * px + s * py, c * py - s * px
        polar.append((math.hypot(px, py), (math.atan2(py, px) - sectors.first) % turn * sectors.per_radian))
    for k in range(count):
        (r, at), (r0, at0), steps = polar[k], polar[k - 1], 1
        change = (at0 - at + 0.5 * whole) % whole - 0.5 * whole if math.isfinite(ranges[k - 1]) else 0.0
        are_near = math.isfinite(ranges[k]) and abs(ranges[k - 1] - ranges[k]) < SURFACE_STEP
        if are_near and abs(change) < MAX_FILL_SECTORS:
            steps = max(1, int(abs(change) + 0.9))
        for step in range(steps):
            sector = math.floor(at + step / steps * change) % round(whole)
            if sector < count:
                seen[sector] = min(seen[sector], r + step / steps * ((r0 if steps > 1 else r) - r))
    return seen


@pytest.mark.parametrize("robot", ["turtlebot3_burger", "mpo_500", "tugbot"])
def test_past_scans_are_shifted_to_where_the_robot_is_now(robot):
    rng = np.random.default_rng(0)
    sectors = Sectors.of(load_robot(robot), 60)
    ranges = np.float32(3.0 + np.sin(np.arange(60) / 5.0) + 0.02 * rng.standard_normal(60))
    ranges[10:14] = np.inf
    for motion in ((0.0, 0.0, 0.0), (0.4, 0.1, 0.5), (-0.8, 0.3, -2.0)):
        seen = np.full(60, np.inf, dtype=np.float32)
        shift_sectors(ranges, motion, sectors, seen, np.empty((2, 60), dtype=np.float32))
        expected = slow_shift(ranges, motion, sectors)
        is_same = np.isclose(seen, expected, rtol=1e-6, atol=1e-3) | (np.isinf(seen) & np.isinf(expected))
        assert is_same.sum() >= 58  # a point on the border of two sectors may be in either
        assert np.isfinite(expected).sum() > 20


def test_what_rests_stays_where_it_is_seen_once_the_motion_is_taken_out():
    _, moved = histories(60, lags=(0.0, 0.5))
    _, left = histories(60, lags=(0.0, 0.5), compensate=False)
    differences = [np.abs(np.diff(step[-1]["scan_history"].reshape(2, 90), axis=0)) for step in (moved, left)]
    assert np.median(differences[0]) < 0.1 * np.median(differences[1])


def test_what_past_scans_did_not_see_is_shown_as_it_is_now():
    env = LidarEnv(ReachGoal, **ROOM, robot="jackal", observations={"scan_history": {"lags": (0.0, 0.4)}})
    env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(np.float32([0.0, 1.0]))
    now, before = observation["scan_history"].reshape(2, 90)
    assert (now[65:] > 0.0).all()
    np.testing.assert_array_equal(before[65:], now[65:])  # sectors revealed by turning left
    assert (before[:55] != now[:55]).mean() > 0.5
    assert (before > 0.0).all()
