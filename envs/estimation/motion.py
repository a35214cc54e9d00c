"""Odometry from wheel encoders and gyroscope."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading


@njit(cache=True, error_model="numpy")
def arc_motion(distance, turn):
    """Return the end pose (x, y, theta) of an arc relative to its start, from signed length [m] and turn [rad]."""
    half = 0.5 * turn
    chord = distance * math.sin(half) / half if half != 0.0 else distance
    return chord * math.cos(half), chord * math.sin(half), turn


@njit(cache=True, error_model="numpy")
def wheel_motion(left_ticks, right_ticks, metres_per_tick, track):
    """Return the displacement (x, y, theta) from wheel encoder counts; `track`: distance between the wheels [m]."""
    left, right = left_ticks * metres_per_tick, right_ticks * metres_per_tick
    return arc_motion(0.5 * (left + right), (right - left) / track)


@njit(cache=True, error_model="numpy")
def update_bias(gyro, yaw_rate, variance):
    """Update the bias estimate `gyro` (bias [rad/s] and variance) in place from a yaw rate measured at rest."""
    innovation, total = yaw_rate - gyro[0], gyro[1] + variance
    if gyro[1] > 0.0 and innovation * innovation <= 9.0 * total:
        gain = gyro[1] / total
        gyro[0] += gain * innovation
        gyro[1] *= 1.0 - gain


@njit(cache=True, error_model="numpy")
def gyro_motion(left_ticks, right_ticks, metres_per_tick, yaw_rate, period, gyro, variance):
    """Return the displacement (x, y, theta) from wheel encoder counts and yaw rate [rad/s].

    Updates the gyroscope bias while the wheels rest (zero-velocity update).
    """
    if left_ticks == 0 and right_ticks == 0:
        update_bias(gyro, yaw_rate, variance)
    return arc_motion(0.5 * (left_ticks + right_ticks) * metres_per_tick, (yaw_rate - gyro[0]) * period)


class WheelMotion:
    """Wheel odometry with nominal wheel geometry."""

    def __init__(self, robot: RobotParams) -> None:
        self._metres_per_tick, self._track = robot.odometry.metres_per_tick, robot.odometry.track
        self._ticks = (0, 0)

    def reset(self, reading: Reading) -> None:
        self._ticks = reading.ticks

    def update(self, reading: Reading) -> Pose2D:
        """Return the base pose relative to the base pose at the last sensor reading, from wheel encoder counts."""
        return Pose2D(*wheel_motion(*self._counts(reading), self._metres_per_tick, self._track))

    def _counts(self, reading: Reading) -> tuple[int, int]:
        (left_before, right_before), (left, right) = self._ticks, reading.ticks
        self._ticks = reading.ticks
        return left - left_before, right - right_before


class GyroMotion(WheelMotion):
    """Odometry with distances from the wheels and turns from the gyroscope, as on the TurtleBot3."""

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        super().__init__(robot)
        self._period = control_period
        self._bias_variance, self.variance = robot.imu.gyro_bias_std**2, robot.imu.gyro_std**2
        self.gyro = np.zeros(2)
        """Estimated gyroscope bias [rad/s] and its variance: shape (2,), float64."""

    def reset(self, reading: Reading) -> None:
        super().reset(reading)
        self.gyro[:] = 0.0, self._bias_variance
        update_bias(self.gyro, reading.yaw_rate, self.variance)

    def update(self, reading: Reading) -> Pose2D:
        counts = self._counts(reading)
        motion = gyro_motion(*counts, self._metres_per_tick, reading.yaw_rate, self._period, self.gyro, self.variance)
        return Pose2D(*motion)


def make_motion_source(robot: RobotParams, control_period: float) -> WheelMotion:
    """Create the odometry selected in a robot's parameters; `control_period`: time between readings [s]."""
    return GyroMotion(robot, control_period) if robot.odometry.uses_gyro else WheelMotion(robot)
