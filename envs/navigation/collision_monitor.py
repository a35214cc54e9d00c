"""A last check of commands: slows a robot down so that it can stop short of what its lidar sees."""

from typing import Any

import numpy as np
from numba import njit

from lidarnaut.envs.navigation.obstacles import scan_points, stoppable_share
from lidarnaut.envs.robots import RobotParams

BRAKING = 0.5
"""Share of the robot's greatest deceleration that is counted on."""
MARGIN = 0.02
"""Distance from what the lidar sees that is kept [m]: its ranges are noisy, and wheels slip."""
CHECKS = 2
"""How often a command is slowed down: slower at the same yaw rate, it is another arc."""


@njit(cache=True, error_model="numpy")
def _slow_down(commands, ranges, active, directions, mount, radius, braking, period):
    points = np.empty((ranges.shape[1], 2))
    for k in range(commands.shape[0]):
        if active[k]:
            count = scan_points(ranges[k], directions, mount, points)
            for _ in range(CHECKS):
                v, w = commands[k, 0], commands[k, 1]
                commands[k, 0] = v * stoppable_share(points[:count], v, w, radius, braking, period)


class CollisionMonitor:
    """Slows commanded twists down, as Nav2's collision monitor does with `action_type: approach`.

    Yaw rates stay as they are, unlike there: a circular footprint can always turn, and a policy that is stopped has to.
    What the last scan shows is taken to rest. Where the lidar does not see, nothing is slowed down.
    """

    def __init__(self, robot: RobotParams, period: float) -> None:
        """Prepare for a robot that is commanded every `period` seconds."""
        lidar = robot.lidar
        mount = lidar.mount.x, lidar.mount.y, lidar.mount.yaw
        self._numbers: Any = lidar.directions, mount, robot.radius + MARGIN, BRAKING * robot.max_acc_v, period

    def slow_down(self, commands: np.ndarray, ranges: np.ndarray, active: np.ndarray) -> None:
        """Rewrite the commands of active robots.

        `commands`: shape (n, 2), float64, forward speed and yaw rate [m/s, rad/s]; `ranges`: shape (n, num_beams),
        float32, last scans [m]; `active`: shape (n,), bool.
        """
        _slow_down(commands, ranges, active, *self._numbers)
