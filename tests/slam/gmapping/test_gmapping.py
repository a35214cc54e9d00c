import math
from functools import partial

import numpy as np

from lidarnaut.envs.estimation import NO_UPDATE
from lidarnaut.envs.geometry import UNKNOWN, Pose2D
from lidarnaut.envs.robots import OdometryNoise
from tests.slam.rooms import CIRCLE, ELSEWHERE, STAY, drive, follow, make_small, see

TIGHT = OdometryNoise(0.001, 0.005, 0.001, 0.001, 0.001)


gmapping = partial(make_small, "gmapping")


def switching(**changes):
    """Weights that follow the noise of each scan: the best particle changes often."""
    return gmapping(likelihood_gain=1.0, switch_margin=0.0, min_travel_distance=0.1, residual_variance=0.02, **changes)


def test_when_another_particle_becomes_the_best_one_the_grid_becomes_its_map():
    slam = switching()
    belief = slam.reset(np.random.default_rng(1))
    grid, poses, redrawn, known = belief.grid, [], 0, np.empty(0)
    for _, belief in follow(slam, CIRCLE[:200], np.random.default_rng(0)):
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
    slam, poses, anchors = gmapping(switch_margin=1e9, resample_below=0.0), [], []
    for _, belief in follow(slam, CIRCLE[:200], np.random.default_rng(0)):
        poses.append(belief.pose)
        anchors.append(slam.anchor)
    slam.finish()
    assert slam.num_switches == slam.num_resamplings == 0
    path = [Pose2D(*slam.belief.path[key_scan]).compose(relative) for key_scan, relative in anchors]
    np.testing.assert_allclose(path, poses, atol=1e-9)


def test_particles_share_what_has_not_changed():
    slam, rng, pose = gmapping(), np.random.default_rng(0), STAY
    slam.update(see(pose, rng), STAY)
    free = int(slam.map.maps.pool.num_free[0])
    assert len(slam.map.maps.pool.words) - free < 40
    for _ in follow(slam, [Pose2D(0.5, 0.0, 0.0)] * 3, rng):
        pass
    slam.map.resample(np.zeros(10, dtype=np.int64))
    assert len(slam.map.maps.pool.words) - slam.map.maps.pool.num_free[0] < 60


def test_a_scan_that_fits_does_not_end_a_loss_but_several_that_are_searched_do():
    slam = gmapping(noise=TIGHT, min_travel_angle=0.3)
    drive(slam, CIRCLE, CIRCLE)
    pose, before, resampled = slam.belief.pose, slam.belief.grid.data.copy(), slam.num_resamplings
    turns = [Pose2D(0.0, 0.0, 0.7 if k % 2 else -0.7) for k in range(6)]
    lost = [slam.update(see(STAY, walls=ELSEWHERE), turn).is_lost for turn in turns]
    assert lost == [False, False, True, True, True, True]
    step = Pose2D(0.2, 0.0, 0.4)
    for k in range(60):
        pose = pose.compose(step)
        belief = slam.update(see(pose), step)
        assert belief.is_lost or k > 0
        if not belief.is_lost:
            break
        np.testing.assert_array_equal(slam.belief.grid.data, before)
    assert math.dist(belief.pose[:2], pose[:2]) < 0.05
    assert slam.num_resamplings == resampled
    assert 0.0 < belief.covariance[0, 0] < 0.2**2
    slam.update(see(pose.compose(step)), step)
    assert slam.belief.update is not NO_UPDATE


def test_a_wheel_that_slips_is_searched_for():
    noise = OdometryNoise(0.002, 0.01, 0.002, 0.01, 0.01)
    rng, far = np.random.default_rng(1), Pose2D(0.5, 0.3, 0.2)
    errors = []
    for retry_below in (0.0, 0.6):
        slam = gmapping(noise=noise, retry_below=retry_below, num_levels=2)
        slam.update(see(STAY, rng), STAY)
        pose = slam.update(see(far, rng), Pose2D(0.9, 0.0, 0.0)).pose
        errors.append(math.hypot(pose.x - far.x, pose.y - far.y))
    assert errors[0] > 0.1
    assert errors[1] < 0.03
