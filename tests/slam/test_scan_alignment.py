import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.robots import LidarParams, Mount
from lidarnaut.envs.slam.scan_alignment import align_scans
from tests.slam.rooms import rectangle, scan

LIDAR = LidarParams(num_beams=360, range_max=20.0, mount=Mount(x=0.1, yaw=0.3))
WALLS = np.concatenate([rectangle(0, 0, 9, 7), [[3, 2, 5, 2], [5, 2, 5, 4], [2, 5, 4, 6], [7, 5, 7, 6]]])


def drive(count=60):
    angle = np.linspace(0.0, 5.5, count)
    return np.column_stack([4.5 + 2.9 * np.sin(angle), 3.5 - 2.6 * np.cos(angle), wrap_angle(angle)])


@pytest.fixture(scope="module")
def scans():
    rng = np.random.default_rng(0)
    exact = [scan(Pose2D(*pose), walls=WALLS, lidar=LIDAR) for pose in drive()]
    return (np.array(exact) + 0.01 * rng.standard_normal((len(exact), 360))).astype(np.float32)


def errors_of(poses, truth):
    error = poses - truth
    error[:, 2] = wrap_angle(error[:, 2])
    return np.sqrt(np.mean(error[:, :2] ** 2)), math.degrees(np.sqrt(np.mean(error[:, 2] ** 2)))


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (3.0, -2.0, 3.0)])
def test_scans_with_drift_fit_together_and_the_first_pose_stays(scans, start):
    frame, rng = Pose2D(*start), np.random.default_rng(1)
    truth = np.array([frame.compose(Pose2D(*pose)) for pose in drive()])
    drifted = truth + np.cumsum(rng.normal(0.0, (0.008, 0.008, 0.003), truth.shape), axis=0)
    drifted[0] = truth[0]
    before, after = errors_of(drifted.copy(), truth), errors_of(align_scans(scans, drifted, LIDAR), truth)
    assert before[0] > 0.01
    assert after[0] < min(0.004, 0.4 * before[0])
    assert after[1] < 0.1
    np.testing.assert_allclose(align_scans(scans, drifted, LIDAR)[0], truth[0], atol=1e-9)


def test_scans_without_returns_keep_their_poses():
    poses = drive(4)
    nothing = np.full((4, 360), np.inf, dtype=np.float32)
    np.testing.assert_allclose(align_scans(nothing, poses, LIDAR), poses, atol=1e-12)
