import math

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import OdometryNoise
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import TinySlam, load_params, make_slam

from .rooms import LIDAR, STAY, see


def test_firm_odometry_is_not_corrected():
    firm = OdometryNoise(1e-5, 0.0, 1e-5, 0.0, 0.0)
    slam = make_slam("tinyslam", LIDAR, odometry_noise=firm)
    slam.update(see(STAY), STAY)
    slam.update(see(Pose2D(0.25, 0.02, 0.0)), Pose2D(0.22, 0.0, 0.0))
    np.testing.assert_allclose(slam.belief.pose, (0.22, 0.0, 0.0), atol=1e-3)


def test_scans_are_integrated_when_the_robot_has_moved():
    slam = make_slam("tinyslam?min_travel_distance=0.25,min_travel_angle=0.1,max_tries=1", LIDAR)
    integrated = []
    for k, motion in enumerate([STAY, *[Pose2D(0.1, 0.0, 0.0)] * 4, *[Pose2D(0.0, 0.0, 0.06)] * 3]):
        before = slam.belief.grid.data.copy()
        slam.update(see(Pose2D(0.1 * min(k, 4), 0.0, 0.06 * max(k - 4, 0))), motion)
        integrated.append(not np.array_equal(before, slam.belief.grid.data))
        assert integrated[-1] or len(slam.belief.update.new_cells) == 0
    assert integrated == [True, False, False, True, False, False, True, False]


def test_frames_of_odometry():
    # The estimated heading differs from odometry by 90 degrees: forward by the wheels is "along x" or "along y".
    nothing = Reading.of_scan(np.full(180, np.nan, dtype=np.float32))
    for frame, expected in (("robot_frame", (0.0, 1.0)), ("odometry_frame", (1.0, 0.0))):
        slam = TinySlam(LIDAR, load_params("default", {"odometry": frame}))
        slam.belief.pose = Pose2D(0.0, 0.0, math.pi / 2)
        slam.update(nothing, Pose2D(1.0, 0.0, 0.0))
        np.testing.assert_allclose(slam.belief.pose, (*expected, math.pi / 2), atol=1e-12)
