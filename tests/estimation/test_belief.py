import numpy as np

from envs.estimation import Correction
from envs.geometry import Pose2D


def test_points_go_with_the_pose_that_they_were_nearest_to():
    poses = [Pose2D(0.0, 0.0, 0.3), Pose2D(5.0, 1.0, -1.0)]
    moved = [Pose2D(0.0, 0.0, 0.3), Pose2D(5.5, 0.0, 2.5)]
    correction = Correction(np.array(poses), np.array(moved))
    points = np.array([(1.0, -0.5), (5.5, 1.5)])
    carried = correction.carry(points)
    np.testing.assert_allclose(carried[0], points[0])
    seen = poses[1].between(Pose2D(*points[1], 0.0))
    np.testing.assert_allclose(carried[1], moved[1].compose(seen)[:2])
    assert correction.carry(np.empty((0, 2))).shape == (0, 2)


def test_without_poses_points_stay():
    nothing = np.empty((0, 3))
    points = np.array([(1.0, 2.0)])
    carried = Correction(nothing, nothing).carry(points)
    np.testing.assert_array_equal(carried, points)
    assert carried is not points
