import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams

PEER_MARGIN = 0.15
"""Margin around another robot's footprint [m]. Beams that end inside hit that robot."""


@njit(cache=True, error_model="numpy")
def remove_peers(ranges, directions, mount, pose, peers, reach):
    """Return a scan with NaN for beams that end within `reach` [m] of another robot's position.

    `directions`: cosine and sine of the beams, shape (2, num_beams); `mount`: position of the lidar, base frame [m];
    `pose`: pose of this robot, and `peers`: positions of other robots, shape (m, 2), map frame [m, rad].
    """
    result = ranges.copy()
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    for i in range(peers.shape[0]):
        dx, dy = peers[i, 0] - x, peers[i, 1] - y
        u, v = c * dx + s * dy - mount[0], c * dy - s * dx - mount[1]
        for k in range(ranges.shape[0]):
            r = float(ranges[k])
            across, along = r * directions[0, k] - u, r * directions[1, k] - v
            # False for NaN and infinity.
            if across * across + along * along < reach * reach:
                result[k] = np.nan
    return result


class PeerFilter:
    """Filter that removes other robots from scans, to keep them out of the map."""

    def __init__(self, robot: RobotParams) -> None:
        self._mount, self._directions = (robot.lidar.mount.x, robot.lidar.mount.y), robot.lidar.directions
        self._reach = robot.radius + PEER_MARGIN

    def __call__(self, ranges: np.ndarray, pose: Pose2D, peers: list[Pose2D]) -> np.ndarray:
        """Return a scan with NaN for beams that end at other robots: shape (num_beams,), float32 [m]."""
        if not peers:
            return ranges
        positions = np.array([peer[:2] for peer in peers])
        return remove_peers(ranges, self._directions, self._mount, tuple(pose), positions, self._reach)

    def hits(self, ranges: np.ndarray, pose: Pose2D, peer: Pose2D) -> np.ndarray:
        """Return the ends of beams that hit the robot at pose `peer`: shape (k, 2), float64, base frame [m]."""
        is_hit = np.isnan(self(ranges, pose, [peer])) & ~np.isnan(ranges)
        points: np.ndarray = self._mount + (ranges[is_hit] * self._directions[:, is_hit]).T
        return points
