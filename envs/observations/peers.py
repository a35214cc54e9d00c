"""Where the other robots of a team are."""

import math

import numpy as np
from gymnasium import spaces

from envs.robot import Robot
from envs.robots import RobotParams

PEERS_RANGE = 16.0
"""Distance along either axis at which an observed peer's position saturates [m]: half of what `map_far` shows."""


class Peers:
    """Estimated poses of the others: forward and to the left over 16 m, cosine and sine of the heading."""

    def __init__(self, num_peers: int) -> None:
        """Take how many others there are."""
        self._num_peers = num_peers

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (4 * num_peers,), float32)`: in one row, since three axes are taken for an image."""
        return spaces.Box(-1.0, 1.0, (4 * self._num_peers,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the others' poses to `out`, in the order of their indices."""
        for row, peer in zip(out.reshape(-1, 4), robot.peers, strict=True):
            away = robot.belief.pose.between(peer.belief.pose)
            row[0] = min(max(away.x / PEERS_RANGE, -1.0), 1.0)
            row[1] = min(max(away.y / PEERS_RANGE, -1.0), 1.0)
            row[2], row[3] = math.cos(away.theta), math.sin(away.theta)
