from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.scan_points import ScanGeometry, project_hits
from lidarnaut.envs.navigation.maps.obstacles import stoppable_share
from lidarnaut.envs.robots import RobotParams

BRAKING = 0.5
"""Fraction of the maximum deceleration assumed for braking."""
STOP_MARGIN = 0.02
"""Distance kept from obstacles, for range noise and wheel slip [m]."""
NUM_PASSES = 2
"""Number of collision checks per command. A check lowers the speed but keeps the yaw rate, which changes the arc."""


@njit(cache=True, error_model="numpy")
def _slow_down(commands, ranges, active, geometry, radius, braking, period):
    points = np.empty((ranges.shape[1], 2))
    for k in range(commands.shape[0]):
        if active[k]:
            count = project_hits(ranges[k], geometry, points.T)
            for _ in range(NUM_PASSES):
                v, w = commands[k, 0], commands[k, 1]
                commands[k, 0] = v * stoppable_share(points[:count], v, w, radius, braking, period)


class CollisionMonitor:
    """Slows robots down so that they can stop before scanned obstacles.

    Like Nav2's collision monitor with `action_type: approach`, but without limiting yaw rates, since a circular
    footprint can always turn. Obstacles are assumed static.
    """

    def __init__(self, robot: RobotParams, period: float) -> None:
        geometry = ScanGeometry.of(robot.lidar)
        self._numbers: Any = geometry, robot.radius + STOP_MARGIN, BRAKING * robot.max_acc_v, period

    def slow_down(self, commands: np.ndarray, ranges: np.ndarray, active: np.ndarray) -> None:
        """Limit the forward speeds of commands in place.

        Args:
            commands: shape (n, 2), float64, forward speed and yaw rate [m/s, rad/s].
            ranges: shape (n, num_beams), float32, last scans [m].
            active: shape (n,), bool, robots to limit.
        """
        _slow_down(commands, ranges, active, *self._numbers)
