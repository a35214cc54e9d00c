import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.slam.matching.branch_and_bound import SearchWindow, angle_step, search
from lidarnaut.envs.slam.matching.fields import Field, build_pyramid

from ..rooms import FLAT, render_field, visible_points

NO_LIMIT = 1 << 40
ABOVE = 50


def brute_force(field, points, pose, window):
    cells = np.where(field.occupancy > ABOVE, field.occupancy, 0).astype(int)
    reach, turns = round(window.half_width / field.resolution), int(window.half_angle / window.angle_step + 1e-9)
    best = None
    for turn in range(-turns, turns + 1):
        theta = pose[2] + turn * window.angle_step
        c, s = math.cos(theta), math.sin(theta)
        u, v = points.astype(float).T
        col0 = np.floor((pose[0] - field.x + c * u - s * v) / field.resolution).astype(int)
        row0 = np.floor((pose[1] - field.y + s * u + c * v) / field.resolution).astype(int)
        for row in range(-reach, reach + 1):
            for col in range(-reach, reach + 1):
                r, q = row0 + row, col0 + col
                inside = (r >= 0) & (q >= 0) & (r < cells.shape[0]) & (q < cells.shape[1])
                total = int(cells[r[inside], q[inside]].sum())
                # Nearest first; smaller turns, clockwise before counter-clockwise; lower rows and columns first.
                key = (-total, row * row + col * col, abs(turn), turn > 0, row, col)
                if best is None or key < best[0]:
                    best = (key, (pose[0] + col * field.resolution, pose[1] + row * field.resolution, theta))
    return best[1], -best[0][0] / (100 * len(points))


def random_field(rng, shape, levels):
    """Return a random field with few values, for many poses with equal scores."""
    values = np.array(levels, dtype=np.int8)
    return Field(values[rng.integers(0, len(values), shape)], -1.0, 0.4, 0.1)


@pytest.mark.parametrize("seed", range(8))
def test_result_equals_brute_force_ties_included(seed):
    rng = np.random.default_rng(seed)
    levels = [(-1, 50, 60, 75, 100), (0, 0, 0, 100), (0, 0, 0, 0, 0, 0, 0, 0, 99)][seed % 3]
    field = random_field(rng, (23, 31), levels)
    points = rng.uniform(-1.2, 1.2, ((3, 12, 40)[seed % 3], 2)).astype(np.float32)
    pose = (rng.uniform(-1.0, 2.0), rng.uniform(0.4, 2.5), rng.uniform(-3, 3))
    window = SearchWindow(0.7, 0.1, 0.04)
    expected, score = brute_force(field, points, pose, window)
    pyramid = build_pyramid(field, 1 + seed % 4, 1.0)
    found = search(pyramid, points, pose, window, 0.0, NO_LIMIT)
    assert found.score == score
    np.testing.assert_allclose(found.pose, expected, atol=1e-9)
    # With the surroundings of the best pose excluded, a distant pose of at most the same score is found.
    other = search(pyramid, points, pose, window, 0.0, NO_LIMIT, (*found.pose, 0.35, 0.05))
    apart = math.dist(other.pose[:2], found.pose[:2]) > 0.35 or abs(other.pose.theta - found.pose.theta) > 0.05
    assert apart
    assert other.score <= score
    # The threshold itself is still found, but no score above it.
    assert search(pyramid, points, pose, window, score, NO_LIMIT).pose == found.pose
    missed = search(pyramid, points, pose, window, score + 1e-6, NO_LIMIT)
    assert missed.pose is None


@pytest.fixture(scope="module")
def room():
    poses = [(1.0 + 0.4 * k, 1.5 + 0.1 * k, 0.3 * k) for k in range(8)]
    return render_field(FLAT, poses)


def test_a_robot_finds_its_pose_in_a_room_with_few_evaluations(room):
    truth = Pose2D(3.1, 2.2, 1.1)
    points = visible_points(FLAT, truth, 120, 10.0)
    window = SearchWindow(1.5, 0.35, angle_step(points, 0.05))
    pyramid = build_pyramid(room, 5, 1.5)
    predicted = (truth.x + 1.1, truth.y - 0.9, truth.theta + 0.28)
    found = search(pyramid, points, predicted, window, 0.5, NO_LIMIT)
    assert found.score > 0.6
    np.testing.assert_allclose(found.pose, truth, rtol=0.0, atol=0.06)
    assert abs(found.pose.theta - truth.theta) <= window.angle_step
    poses = 61 * 61 * (2 * int(0.35 / window.angle_step) + 1)
    assert found.evaluations < 0.03 * poses
    missed = search(pyramid, points, predicted, window._replace(half_width=0.4), 0.7, NO_LIMIT)
    assert missed.pose is None
    assert missed.score == 0.0


def test_work_is_bounded(room):
    points = visible_points(FLAT, (3.1, 2.2, 1.1), 60, 10.0)
    pyramid = build_pyramid(room, 4, 1.0)
    window, predicted = SearchWindow(1.0, 0.3, 0.02), (3.5, 2.0, 1.2)
    whole = search(pyramid, points, predicted, window, 0.3, NO_LIMIT)
    for limit in (0, 10, whole.evaluations // 2, whole.evaluations - 1):
        cut = search(pyramid, points, predicted, window, 0.3, limit)
        assert cut.evaluations <= limit
    assert search(pyramid, points, predicted, window, 0.3, whole.evaluations) == whole


def test_steps_between_headings_follow_the_range_of_points():
    circle = np.stack([np.cos(np.arange(50)), np.sin(np.arange(50))], axis=1).astype(np.float32)
    assert angle_step(5.0 * circle, 0.05) == pytest.approx(0.015, rel=1e-5)
    assert angle_step(0.5 * circle, 0.05) == 0.03
    assert angle_step(40.0 * circle, 0.05) == 0.006
