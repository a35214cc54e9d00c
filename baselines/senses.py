"""Readings as the environments' observations show them."""

import numpy as np

from envs.estimation.motion import make_motion_source
from envs.observations.scan import scale_scan
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


class Senses:
    """Turns readings into `scan` and `motion` of an observation, and actions into twists."""

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        """Prepare for an episode."""
        self._robot = robot
        self._period = control_period
        self._odometry = make_motion_source(robot, control_period)
        self._has_ticks = False
        self._action = np.zeros(2, dtype=np.float32)

    def observe(self, reading: Reading) -> dict[str, np.ndarray]:
        """Return `scan` and `motion`; see `ExploreEnv`. The time that has passed is left out."""
        if not self._has_ticks:
            self._odometry.reset(reading)
            self._has_ticks = True
        moved = self._odometry.update(reading)
        scan = np.empty_like(reading.ranges)
        scale_scan(reading.ranges, self._robot.lidar.range_max, scan)
        robot, v, w = self._robot, moved.x / self._period, moved.theta / self._period
        motion = np.array([v / robot.max_v, w / robot.max_w, *self._action, reading.bumper, 0.0], dtype=np.float32)
        motion = motion.clip(-1.0, 1.0)
        return {"scan": scan, "motion": motion}

    def twist(self, action: np.ndarray) -> Twist:
        """Return the twist [m/s, rad/s] that an action asks for, and remember that it was asked for."""
        self._action = action
        return Twist(float(action[0]) * self._robot.max_v, float(action[1]) * self._robot.max_w)
