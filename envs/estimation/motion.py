"""Sources of motion: how far a robot has come since the last reading, by its own sensors."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading


@njit(cache=True, error_model="numpy")
def arc_motion(distance, turn):
    """Return, as (x, y, theta), the end of an arc of a length [m], below 0 backward, and turn [rad], from its start."""
    half = 0.5 * turn
    chord = distance * math.sin(half) / half if half != 0.0 else distance
    return chord * math.cos(half), chord * math.sin(half), turn


@njit(cache=True, error_model="numpy")
def wheel_motion(left_ticks, right_ticks, metres_per_tick, track):
    """Return the motion by the encoder counts of evenly turning wheels, a `track` [m] apart; see `arc_motion`."""
    left, right = left_ticks * metres_per_tick, right_ticks * metres_per_tick
    return arc_motion(0.5 * (left + right), (right - left) / track)


@njit(cache=True, error_model="numpy")
def update_bias(gyro, yaw_rate, variance):
    """Estimate the bias [rad/s] and its variance `gyro`, in place, by a yaw rate at rest and its noise's variance."""
    innovation, total = yaw_rate - gyro[0], gyro[1] + variance
    if gyro[1] > 0.0 and innovation * innovation <= 9.0 * total:
        gain = gyro[1] / total
        gyro[0] += gain * innovation
        gyro[1] *= 1.0 - gain


@njit(cache=True, error_model="numpy")
def gyro_motion(left_ticks, right_ticks, metres_per_tick, yaw_rate, period, gyro, variance):
    """Return the motion of the base by the wheels and the measured yaw rate; see `wheel_motion`.

    While the wheels rest, what the gyroscope measures is its bias (a zero-velocity update); see `update_bias` for
    `gyro` and `variance`.
    """
    if left_ticks == 0 and right_ticks == 0:
        update_bias(gyro, yaw_rate, variance)
    return arc_motion(0.5 * (left_ticks + right_ticks) * metres_per_tick, (yaw_rate - gyro[0]) * period)


class WheelMotion:
    """Wheel odometry, with the wheels as the controller takes them to be."""

    def __init__(self, robot: RobotParams) -> None:
        self._metres_per_tick, self._track = robot.odometry.metres_per_tick, robot.odometry.track
        self._ticks = (0, 0)

    def reset(self, reading: Reading) -> None:
        """Start at a reading."""
        self._ticks = reading.ticks

    def update(self, reading: Reading) -> Pose2D:
        """Return the pose of the base now, seen from the base at the last reading."""
        return Pose2D(*wheel_motion(*self._counts(reading), self._metres_per_tick, self._track))

    def _counts(self, reading: Reading) -> tuple[int, int]:
        """Return the counts of the left and the right wheel since the last reading."""
        (left_before, right_before), (left, right) = self._ticks, reading.ticks
        self._ticks = reading.ticks
        return left - left_before, right - right_before


class GyroMotion(WheelMotion):
    """Odometry that takes distances from the wheels and turns from the gyroscope, as the TurtleBot3's own does.

    Wheels that slip falsify the heading most, where the gyroscope drifts slowly. Its bias is estimated while the robot
    rests, as at the start.
    """

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        super().__init__(robot)
        self._period = control_period
        self._bias_variance, self.variance = robot.imu.gyro_bias_std**2, robot.imu.gyro_std**2
        self.gyro = np.zeros(2)
        """Shape (2,), float64: estimated bias [rad/s] and its variance."""

    def reset(self, reading: Reading) -> None:
        """Start at a reading, at rest."""
        super().reset(reading)
        self.gyro[:] = 0.0, self._bias_variance
        update_bias(self.gyro, reading.yaw_rate, self.variance)

    def update(self, reading: Reading) -> Pose2D:
        """Return the pose of the base now, seen from the base at the last reading."""
        counts = self._counts(reading)
        motion = gyro_motion(*counts, self._metres_per_tick, reading.yaw_rate, self._period, self.gyro, self.variance)
        return Pose2D(*motion)


def make_motion_source(robot: RobotParams, control_period: float) -> WheelMotion:
    """Return a robot's own odometry, for readings a `control_period` [s] apart; its YAML file says which it is."""
    return GyroMotion(robot, control_period) if robot.odometry.uses_gyro else WheelMotion(robot)
