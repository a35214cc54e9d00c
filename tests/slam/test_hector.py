import math

import numpy as np
import pytest

from envs.estimation import NO_UPDATE
from envs.geometry import Pose2D
from envs.robots import OdometryNoise
from envs.simulation import Reading
from envs.slam import HectorParams, load_params, make_slam

from .rooms import BOX, BY_WHEELS, CIRCLE, CORRIDOR, LIDAR, ROOM, STAY, WHEELS, drive, scan


def distance(a, b):
    return math.hypot(a.x - b.x, a.y - b.y)


def hector(preset="default", noise=WHEELS, **changes):
    sizes = {"map_width": 20.0, "map_height": 20.0, "min_travel_angle": 0.3}
    params = load_params(preset, {**sizes, **changes}, "hector")
    return make_slam("hector", LIDAR, 0.05, params, noise)


@pytest.mark.parametrize("preset", ["default", "intel"])
def test_odometry_that_errs_is_corrected(preset):
    truth, estimated = drive(hector(preset), CIRCLE, BY_WHEELS)
    assert distance(truth, estimated) < 0.03
    assert abs(estimated.theta - truth.theta) < 0.02


def test_without_odometry_every_scan_is_matched_to_the_last_pose():
    truth, estimated = drive(hector("faithful"), CIRCLE, [Pose2D(9.0, 9.0, 1.0)] * 400)
    assert distance(truth, estimated) < 0.03
    assert abs(estimated.theta - truth.theta) < 0.02


def test_a_robot_that_stands_still_does_not_drift():
    _, after_a_minute = drive(hector(), [STAY] * 600, [STAY] * 600)
    assert after_a_minute == STAY


def test_nothing_is_random():
    def run(seed):
        slam = hector()
        rng = np.random.default_rng(7)
        slam.reset(np.random.default_rng(seed))
        pose = STAY
        for motion in [STAY, *CIRCLE[:60]]:
            pose = pose.compose(motion)
            slam.update(Reading.of_scan(scan(pose, rng)), motion)
        return np.array(slam.belief.pose).tobytes() + slam.belief.grid.data.tobytes()

    assert run(1) == run(2)


def test_between_key_scans_the_pose_follows_odometry():
    slam = hector(min_travel_distance=0.1, min_travel_angle=1.0)
    slam.update(Reading.of_scan(scan(STAY)), STAY)
    for k in range(1, 4):
        belief = slam.update(Reading.of_scan(scan(Pose2D(0.03 * k, 0.0, 0.0))), Pose2D(0.035, 0.0, 0.0))
        is_key = k == 3  # 0.105 m by odometry
        assert (belief.update is NO_UPDATE) != is_key
        assert (belief.pose.x == pytest.approx(0.035 * k, abs=1e-12)) != is_key
    assert slam.last_key_pose == belief.pose
    assert distance(belief.pose, Pose2D(0.09, 0.0, 0.0)) < 0.014


def test_a_key_scan_follows_from_the_last_key_pose_and_the_predicted_one():
    """The motions in between may be composed elsewhere."""
    whole, parts = hector(), hector()
    for slam in (whole, parts):
        slam.reset(np.random.default_rng(0))
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


def test_covariance_is_long_along_a_corridor_and_small_in_a_room():
    motions = [Pose2D(0.02, 0.0, 0.0)] * 200
    slam = hector()
    drive(slam, motions, motions, walls=CORRIDOR)
    along, across = np.sqrt(np.diag(slam.belief.covariance)[:2])
    assert along > 5 * across
    assert along > 0.02
    drive(slam, motions[:100], motions[:100])
    in_a_room = np.sqrt(np.diag(slam.belief.covariance)[:2])
    assert in_a_room.max() < 0.5 * along
    np.testing.assert_array_equal(slam.belief.covariance, slam.belief.covariance.T)


def test_without_returns_the_prediction_remains_until_the_robot_is_lost():
    slam = hector(max_position_std=0.1)
    slam.update(Reading.of_scan(scan(STAY)), STAY)
    for k in range(1, 60):
        belief = slam.update(Reading.of_scan(np.full(180, np.nan, dtype=np.float32)), Pose2D(0.2, 0.0, 0.0))
        np.testing.assert_allclose(belief.pose, (0.2 * k, 0.0, 0.0), atol=1e-9)
        std = math.sqrt(np.linalg.eigvalsh(belief.covariance[:2, :2])[-1])
        assert belief.is_lost == (std > 0.1)
    assert belief.is_lost


def test_a_kidnapped_robot_is_lost_leaves_the_map_alone_and_comes_back():
    slam = hector(noise=OdometryNoise(0.001, 0.005, 0.001, 0.001, 0.001))
    drive(slam, CIRCLE, CIRCLE)
    pose, before = slam.belief.pose, slam.belief.grid.data.copy()
    elsewhere = [(-0.5, -0.4, 0.5, -0.4), (0.5, -0.4, 0.5, 0.4), (0.5, 0.4, -0.5, 0.4), (-0.5, 0.4, -0.5, -0.4)]
    lost = [
        slam.update(Reading.of_scan(scan(STAY, walls=elsewhere)), Pose2D(0.0, 0.0, 0.4 if k % 2 else -0.4)).is_lost
        for k in range(6)
    ]
    assert lost == [False, False, True, True, True, True]
    np.testing.assert_array_equal(slam.belief.grid.data, before)
    belief = slam.update(Reading.of_scan(scan(pose.compose(Pose2D(0.2, 0.0, 0.1)))), Pose2D(0.2, 0.0, 0.0))
    assert not belief.is_lost
    assert distance(belief.pose, pose.compose(Pose2D(0.2, 0.0, 0.0))) < 0.03
    assert belief.update is not NO_UPDATE


def test_a_bad_prediction_is_searched_farther_around():
    slam = hector(noise=OdometryNoise(0.001, 0.005, 0.001, 0.001, 0.001))
    drive(slam, CIRCLE, CIRCLE)
    pose, slip = slam.belief.pose, Pose2D(0.4, -0.3, 0.2)
    belief = slam.update(Reading.of_scan(scan(pose.compose(slip))), Pose2D(0.0, 0.0, 0.3))
    assert distance(belief.pose, pose.compose(slip)) < 0.03
    assert abs(belief.pose.theta - pose.theta - slip.theta) < 0.02
    assert not belief.is_lost


def test_robots_share_a_map():
    first, second = hector(), hector()
    first.reset(np.random.default_rng(0))
    aside = Pose2D(1.0, -0.5, 2.0)
    second.reset(np.random.default_rng(1), aside, first.map)
    first.update(Reading.of_scan(scan(STAY)), STAY)
    second.update(Reading.of_scan(scan(aside)), STAY)
    assert second.belief.grid is first.belief.grid
    far = scan(aside, walls=[(-40, -1, -40, 1)], lidar=LIDAR)
    far[:] = 5.9
    first.update(Reading.of_scan(far), Pose2D(8.0, 0.0, 0.0))  # the map grows
    moved = aside.compose(Pose2D(0.0, 0.0, 0.4))
    belief = second.update(Reading.of_scan(scan(moved)), Pose2D(0.0, 0.0, 0.38))
    assert distance(belief.pose, moved) < 0.02
    assert belief.pose.theta == pytest.approx(moved.theta, abs=0.015)


def test_presets_belong_to_their_slam():
    assert load_params("default", slam="hector") == HectorParams()
    with pytest.raises(ValueError, match=r"unknown preset of hector 'upstream'.*default, faithful, intel"):
        make_slam("hector", LIDAR, preset="upstream")
    with pytest.raises(ValueError, match=r"unknown preset of tinyslam 'faithful'.*every_scan"):
        make_slam("tinyslam", LIDAR, preset="faithful")
    assert make_slam("hector", LIDAR, 0.1, odometry_noise=WHEELS).params.odometry_noise == WHEELS
    for changes, complaint in (
        ({"num_levels": 9}, "num_levels: .*less than or equal to 6, got 9"),
        ({"empty_prob": 0.5}, "empty_prob: .*less than 0.5, got 0.5"),
        ({"search_distance": -1.0}, "search_distance: .*greater than or equal to 0"),
        ({"odometry_noise": {"position_std": 0.0}}, "position_std: Input should be greater than 0"),
        ({"hole_width": 1.0}, "unknown key 'hole_width'"),
    ):
        with pytest.raises(ValueError, match=complaint):
            load_params("default", changes, "hector")


def test_the_room_is_where_it_is():
    slam = hector()
    drive(slam, CIRCLE, BY_WHEELS)
    rows, cols = np.nonzero(slam.belief.grid.data > 65)
    centers = slam.belief.grid.centers(np.stack([rows, cols], axis=1))
    segments = np.array(ROOM + BOX, dtype=float)
    a, b = segments[:, None, :2], segments[:, None, 2:]
    t = np.clip(((centers - a) * (b - a)).sum(2) / ((b - a) ** 2).sum(2), 0.0, 1.0)
    nearest = np.hypot(*np.moveaxis(centers - a - t[..., None] * (b - a), 2, 0)).min(0)
    assert np.quantile(nearest, 0.95) < 0.08
