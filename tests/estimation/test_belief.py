import numpy as np

from lidarnaut.envs.estimation import Correction
from lidarnaut.envs.estimation.trail import TRAIL_SPACING, Trail, interpolate
from lidarnaut.envs.geometry import Pose2D


def test_points_go_with_the_pose_that_they_were_nearest_to():
    poses = [Pose2D(0.0, 0.0, 0.3), Pose2D(5.0, 1.0, -1.0)]
    moved = [Pose2D(0.0, 0.0, 0.3), Pose2D(5.5, 0.0, 2.5)]
    correction = Correction(np.array(poses), np.array(moved))
    points = np.array([(1.0, -0.5), (5.5, 1.5)])
    carried = correction.apply(points)
    np.testing.assert_allclose(carried[0], points[0])
    seen = poses[1].between(Pose2D(*points[1], 0.0))
    np.testing.assert_allclose(carried[1], moved[1].compose(seen)[:2])
    assert correction.apply(np.empty((0, 2))).shape == (0, 2)
    unmoved = Correction(np.empty((0, 3)), np.empty((0, 3))).apply(points)
    np.testing.assert_array_equal(unmoved, points)
    assert unmoved is not points


def test_a_trail_keeps_positions_apart_and_grows():
    trail = Trail()
    for k in range(6001):
        trail.append(Pose2D(0.01 * k, 0.0, 0.0))
    assert 500 <= len(trail.positions) <= 601
    assert np.diff(trail.positions[:, 0]).min() >= 0.1 - 1e-9


def test_positions_between_far_ones_lie_on_straight_lines():
    given = np.array([[0.0, 0.0], [0.33, 0.44], [0.33, 0.44], [0.35, 0.44], [0.35, -0.61]])
    dense = interpolate(given)
    np.testing.assert_array_equal(dense[[0, -1]], given[[0, -1]])
    np.testing.assert_allclose(dense[:6], np.outer(np.arange(6) / 5, (0.33, 0.44)), atol=1e-12)
    assert len(dense) == 5 + 1 + 1 + 10 + 1
    np.testing.assert_array_equal(interpolate(given[:1]), given[:1])
    trail = Trail()
    trail.replace(interpolate(np.array([[0.0, 0.0], [0.0, 2.05]])))
    assert np.diff(trail.positions[:, 1]).max() < 1.2 * TRAIL_SPACING
