"""Exact scans of a small room, for tests of SLAMs."""

import numpy as np

from envs.geometry import Pose2D
from envs.geometry.raycast import cast_rays
from envs.robots import LidarParams, Mount
from envs.simulation import Reading

LIDAR = LidarParams(num_beams=180, range_max=6.0, mount=Mount(x=-0.05, y=0.02, yaw=0.1))
STAY = Pose2D(0.0, 0.0, 0.0)
# A room of 6 m x 5 m with a box in it, around the start.
ROOM = [(-3, -2, 3, -2), (3, -2, 3, 3), (3, 3, -3, 3), (-3, 3, -3, -2)]
BOX = [(1, 0.5, 1.6, 0.7), (1.6, 0.7, 1.3, 1.4), (1.3, 1.4, 1, 0.5)]
CORRIDOR = [(-50, -1, 50, -1), (-50, 1, 50, 1)]


def scan(pose, rng=None, noise=0.01, walls=ROOM + BOX, lidar=LIDAR):
    """Ranges of the lidar at a pose, with noise if there is a generator."""
    out = np.empty(lidar.num_beams, dtype=np.float32)
    sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    cast_rays(*sensor, lidar.beams, np.array(walls, dtype=float), np.empty((0, 3)), out)
    return out if rng is None else (out + rng.normal(0.0, noise, out.shape)).astype(np.float32)


def drive(slam, motions, odometry, seed=0, walls=ROOM + BOX):
    """Return the true and the estimated pose after the motions, of which odometry measures others."""
    rng = np.random.default_rng(seed)
    slam.reset(np.random.default_rng(seed + 1))
    pose = STAY
    slam.update(Reading.of_scan(scan(pose, rng, walls=walls)), STAY)
    for motion, measured in zip(motions, odometry):
        pose = pose.compose(motion)
        slam.update(Reading.of_scan(scan(pose, rng, walls=walls)), measured)
    return pose, slam.belief.pose
