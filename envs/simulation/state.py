"""The state of a simulated robot as a row of numbers, which both physics write and the sensors read."""

import numpy as np

from envs.geometry import Pose2D

from .simulator import RobotState, Twist

X, Y, THETA, COMMANDED_V, COMMANDED_W, LEFT_ANGLE, RIGHT_ANGLE, V, W = range(9)
"""Entries of a row: pose in the world frame [m, m, rad], the controller's twist after its ramp [m/s, rad/s], how far
the wheels have turned since the reset, as encoders measure it [rad], and the true twist of the base [m/s, rad/s]."""
STATE_SIZE = 9
"""Number of entries of a row."""


def robot_states(rows: np.ndarray) -> list[RobotState]:
    """Return the ground truth in rows of shape (num_robots, 9), float64."""
    return [RobotState(Pose2D(x, y, theta), Twist(v, w)) for x, y, theta, _, _, _, _, v, w in rows.tolist()]
