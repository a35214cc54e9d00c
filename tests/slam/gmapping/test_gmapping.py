import math

import numpy as np
import pytest

from envs.core import LidarEnv
from envs.estimation import NO_UPDATE
from envs.geometry import UNKNOWN, Pose2D
from envs.robots import OdometryNoise
from envs.simulation import Reading
from envs.slam import GMappingParams, load_params, make_slam
from envs.tasks.explore import ExploreTeam
from tests.slam.rooms import BY_WHEELS, CIRCLE, CORRIDOR, LIDAR, STAY, WHEELS, drive, scan

TIGHT = OdometryNoise(0.001, 0.005, 0.001, 0.001, 0.001)
NO_RETURN = np.full(180, np.nan, dtype=np.float32)


def gmapping(preset="default", noise=WHEELS, **changes):
    small = {"map_width": 10.0, "map_height": 10.0, "num_particles": 10}
    return make_slam("gmapping", LIDAR, 0.05, load_params(preset, {**small, **changes}, "gmapping"), noise)


def switching(**changes):
    """Weights that follow the noise of each scan: the best particle changes often."""
    return gmapping(likelihood_gain=1.0, switch_margin=0.0, min_travel_distance=0.1, residual_variance=0.02, **changes)


@pytest.mark.parametrize("preset", ["default", "intel"])
def test_odometry_that_errs_is_corrected(preset):
    slam = gmapping(preset)
    truth, estimated = drive(slam, CIRCLE, BY_WHEELS)
    assert math.hypot(truth.x - estimated.x, truth.y - estimated.y) < 0.05
    assert abs(estimated.theta - truth.theta) < 0.03
    assert not slam.belief.is_lost


def test_same_seed_same_bytes():
    def run(slam, seed):
        rng, out = np.random.default_rng(7), b""
        slam.reset(np.random.default_rng(seed))
        pose = STAY
        for motion in [STAY, *CIRCLE[:150]]:
            pose = pose.compose(motion)
            belief = slam.update(Reading.of_scan(scan(pose, rng)), motion)
            out += np.array(belief.pose).tobytes()
        return out + belief.grid.data.tobytes() + belief.covariance.tobytes() + slam.poses.tobytes()

    slam = switching()
    first = run(slam, 1)
    assert slam.num_resamplings > 3
    assert run(slam, 1) == first
    assert run(switching(), 1) == first
    assert run(slam, 2) != first


def test_when_another_particle_becomes_the_best_one_the_grid_becomes_its_map():
    slam, rng, pose = switching(), np.random.default_rng(0), STAY
    belief = slam.reset(np.random.default_rng(1))
    grid, poses, redrawn, known = belief.grid, [], 0, np.empty(0)
    for motion in [STAY, *CIRCLE[:200]]:
        pose = pose.compose(motion)
        belief = slam.update(Reading.of_scan(scan(pose, rng)), motion)
        poses.append(belief.pose)
        assert belief.grid is grid
        np.testing.assert_array_equal(grid.data, slam.map.occupancy(slam.best))
        if belief.update.redrawn:
            redrawn += 1
            np.testing.assert_allclose(belief.path[-1], belief.pose, atol=1e-12)
            assert slam.anchor == (len(belief.path) - 1, STAY)
            known = np.argwhere(grid.data != UNKNOWN)
            np.testing.assert_array_equal(belief.update.new_cells, known)
            assert belief.update.origin == grid.origin
        elif belief.update is not NO_UPDATE:
            assert belief.path is None
    assert redrawn == slam.num_switches > 3
    slam.finish()
    key_scan, relative = slam.anchor
    assert key_scan == len(belief.path) - 1
    np.testing.assert_allclose(Pose2D(*belief.path[-1]).compose(relative), poses[-1], atol=1e-12)


def test_without_a_switch_the_path_is_the_poses_as_they_were_estimated():
    slam, rng, pose, poses = gmapping(switch_margin=1e9, resample_below=0.0), np.random.default_rng(0), STAY, []
    anchors = []
    for motion in [STAY, *CIRCLE[:200]]:
        pose = pose.compose(motion)
        poses.append(slam.update(Reading.of_scan(scan(pose, rng)), motion).pose)
        anchors.append(slam.anchor)
    slam.finish()
    assert slam.num_switches == slam.num_resamplings == 0
    path = [Pose2D(*slam.belief.path[key_scan]).compose(relative) for key_scan, relative in anchors]
    np.testing.assert_allclose(path, poses, atol=1e-9)


def test_particles_share_what_has_not_changed():
    slam, rng, pose = gmapping(), np.random.default_rng(0), STAY
    slam.update(Reading.of_scan(scan(pose, rng)), STAY)
    free = int(slam.map.maps.pool.num_free[0])
    assert len(slam.map.maps.pool.words) - free < 40
    motion = Pose2D(0.5, 0.0, 0.0)
    for _ in range(3):
        pose = pose.compose(motion)
        slam.update(Reading.of_scan(scan(pose, rng)), motion)
    slam.map.resample(np.zeros(10, dtype=np.int64))
    assert len(slam.map.maps.pool.words) - slam.map.maps.pool.num_free[0] < 60


def test_covariance_is_long_along_a_corridor_and_small_in_a_room():
    motions = [Pose2D(0.1, 0.0, 0.0)] * 60
    slam = gmapping(num_particles=30)
    drive(slam, motions, motions, walls=CORRIDOR)
    along, across = np.sqrt(np.diag(slam.belief.covariance)[:2])
    assert along > 2 * across
    assert along > 0.05
    drive(slam, motions[:20], motions[:20])
    in_a_room = np.sqrt(np.diag(slam.belief.covariance)[:2])
    assert 0.0 < in_a_room.max() < 0.5 * along
    np.testing.assert_array_equal(slam.belief.covariance, slam.belief.covariance.T)


def test_without_returns_the_best_particle_follows_odometry_until_the_robot_is_lost():
    slam = gmapping(max_position_std=0.2)
    slam.update(Reading.of_scan(scan(STAY)), STAY)
    for k in range(1, 60):
        belief = slam.update(Reading.of_scan(NO_RETURN), Pose2D(0.5, 0.0, 0.0))
        np.testing.assert_allclose(belief.pose, (0.5 * k, 0.0, 0.0), atol=1e-9)
        std = math.sqrt(np.linalg.eigvalsh(belief.covariance[:2, :2])[-1])
        assert belief.is_lost == (std > 0.2)
    assert belief.is_lost


def test_a_scan_that_fits_does_not_end_a_loss_but_several_that_are_searched_do():
    slam = gmapping(noise=TIGHT, min_travel_angle=0.3)
    drive(slam, CIRCLE, CIRCLE)
    pose, before, resampled = slam.belief.pose, slam.belief.grid.data.copy(), slam.num_resamplings
    # Key scans by their turns, in a box of 1 m x 0.8 m.
    elsewhere = [(-0.5, -0.4, 0.5, -0.4), (0.5, -0.4, 0.5, 0.4), (0.5, 0.4, -0.5, 0.4), (-0.5, 0.4, -0.5, -0.4)]
    turns = [Pose2D(0.0, 0.0, 0.7 if k % 2 else -0.7) for k in range(6)]
    lost = [slam.update(Reading.of_scan(scan(STAY, walls=elsewhere)), turn).is_lost for turn in turns]
    assert lost == [False, False, True, True, True, True]
    step = Pose2D(0.2, 0.0, 0.4)
    for k in range(60):
        pose = pose.compose(step)
        belief = slam.update(Reading.of_scan(scan(pose)), step)
        assert belief.is_lost or k > 0
        if not belief.is_lost:
            break
        np.testing.assert_array_equal(slam.belief.grid.data, before)
    assert math.dist(belief.pose[:2], pose[:2]) < 0.05
    assert slam.num_resamplings == resampled
    assert 0.0 < belief.covariance[0, 0] < 0.2**2
    slam.update(Reading.of_scan(scan(pose.compose(step))), step)
    assert slam.belief.update is not NO_UPDATE


def test_a_wheel_that_slips_is_searched_for():
    noise = OdometryNoise(0.002, 0.01, 0.002, 0.01, 0.01)
    rng, far = np.random.default_rng(1), Pose2D(0.5, 0.3, 0.2)
    errors = []
    for retry_below in (0.0, 0.6):
        slam = gmapping(noise=noise, retry_below=retry_below, num_levels=2)
        slam.update(Reading.of_scan(scan(STAY, rng)), STAY)
        pose = slam.update(Reading.of_scan(scan(far, rng)), Pose2D(0.9, 0.0, 0.0)).pose
        errors.append(math.hypot(pose.x - far.x, pose.y - far.y))
    assert errors[0] > 0.1
    assert errors[1] < 0.03


def test_one_particle_is_enough_to_run():
    truth, estimated = drive(gmapping(num_particles=1), CIRCLE[:100], BY_WHEELS[:100])
    assert math.hypot(truth.x - estimated.x, truth.y - estimated.y) < 0.05


def test_no_map_can_be_given_and_teams_are_refused():
    slam = gmapping()
    with pytest.raises(ValueError, match="a map for each particle"):
        slam.reset(np.random.default_rng(0), STAY, slam.map)
    with pytest.raises(ValueError, match="cannot share a map"):
        LidarEnv(ExploreTeam, world="rooms", physics="kinematic", slam="gmapping", num_robots=2)


def test_presets_load_and_bad_values_are_named():
    assert load_params("default", slam="gmapping") == GMappingParams()
    for name, value in [("num_particles", 0), ("likelihood_gain", 0.0), ("resample_below", 1.5), ("num_levels", 5)]:
        with pytest.raises(ValueError, match=name):
            GMappingParams(**{name: value})
    with pytest.raises(ValueError, match="particles"):
        load_params("default", {"particles": 3}, "gmapping")
