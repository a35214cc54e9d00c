import math

import numpy as np
import pytest

from lidarnaut.envs.estimation import NO_UPDATE
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import OdometryNoise
from lidarnaut.envs.simulation import Reading

from .rooms import CIRCLE, LIDAR, STAY, drive, make_small, scan, see

FIRM = OdometryNoise(0.001, 0.005, 0.001, 0.001, 0.001)


def test_between_key_scans_the_pose_follows_odometry():
    slam = make_small("hector", min_travel_distance=0.1, min_travel_angle=1.0)
    slam.update(see(STAY), STAY)
    for k in range(1, 4):
        belief = slam.update(see(Pose2D(0.03 * k, 0.0, 0.0)), Pose2D(0.035, 0.0, 0.0))
        is_key = k == 3  # 0.105 m by odometry
        assert (belief.update is NO_UPDATE) != is_key
        assert (belief.pose.x == pytest.approx(0.035 * k, abs=1e-12)) != is_key
    assert slam.last_key_pose == belief.pose
    assert math.dist(belief.pose[:2], (0.09, 0.0)) < 0.014


def test_a_key_scan_follows_from_the_last_key_pose_and_the_predicted_one():
    """The motions in between may be composed elsewhere."""
    whole, parts = make_small("hector"), make_small("hector")
    rng, pose, composed = np.random.default_rng(3), STAY, STAY
    for motion in [STAY, *CIRCLE[:100]]:
        pose, composed = pose.compose(motion), composed.compose(motion)
        ranges = scan(pose, rng)
        whole.update(Reading.of_scan(ranges), motion)
        if parts.is_key_pose(composed):
            composed = parts.process_key_scan(ranges, composed).pose
        assert whole.belief.pose == composed
    np.testing.assert_array_equal(whole.belief.covariance, parts.belief.covariance)
    np.testing.assert_array_equal(whole.belief.grid.data, parts.belief.grid.data)


@pytest.mark.parametrize("meets_people", [False, True])
def test_a_bad_prediction_is_searched_farther_around_but_not_among_people(meets_people):
    slam = make_small("hector", noise=FIRM)
    slam.meets_people = meets_people
    slam.reset(np.random.default_rng(0))
    drive(slam, CIRCLE, CIRCLE)
    before, turn = slam.belief.pose, Pose2D(0.0, 0.0, 0.3)
    pose = (before.compose(turn) if meets_people else before).compose(Pose2D(0.4, -0.3, 0.2))
    belief = slam.update(see(pose), turn)
    if meets_people:
        assert math.dist(belief.pose[:2], before[:2]) < 0.1
    else:
        np.testing.assert_allclose(belief.pose, pose, atol=0.02)
        assert not belief.is_lost


def test_who_stands_around_the_robot_neither_moves_nor_loses_it_and_is_mapped():
    slam = make_small("hector")
    slam.meets_people = True
    slam.reset(np.random.default_rng(0))
    people = np.array([[0.8 * math.cos(a), 0.8 * math.sin(a), 0.3] for a in np.linspace(-2.6, 2.6, 5)])
    slam.update(see(STAY), STAY)
    for k in range(1, 6):
        pose = Pose2D(0.02 * k, 0.0, 0.31 * k)
        ranges = scan(pose, circles=people)
        slam.unmatched = ranges < scan(pose)
        assert 0.3 < slam.unmatched.mean() < 0.9
        belief = slam.update(Reading.of_scan(ranges), Pose2D(0.02, 0.0, 0.31) if k > 1 else pose)
        assert not belief.is_lost
        assert belief.update.window is not None
    assert math.dist(belief.pose[:2], pose[:2]) < 0.03
    occupied = belief.grid.centers(np.argwhere(belief.grid.data > 65))
    assert (np.hypot(*(occupied - people[2, :2]).T) < 0.35).any()


def test_robots_share_a_map():
    first, second = make_small("hector"), make_small("hector")
    first.reset(np.random.default_rng(0))
    aside = Pose2D(1.0, -0.5, 2.0)
    second.reset(np.random.default_rng(1), aside, first.map)
    first.update(see(STAY), STAY)
    second.update(see(aside), STAY)
    assert second.belief.grid is first.belief.grid
    far = scan(aside, walls=[(-40, -1, -40, 1)], lidar=LIDAR)
    far[:] = 5.9
    first.update(Reading.of_scan(far), Pose2D(8.0, 0.0, 0.0))
    moved = aside.compose(Pose2D(0.0, 0.0, 0.4))
    belief = second.update(see(moved), Pose2D(0.0, 0.0, 0.38))
    assert math.dist(belief.pose[:2], moved[:2]) < 0.02
    assert belief.pose.theta == pytest.approx(moved.theta, abs=0.015)
