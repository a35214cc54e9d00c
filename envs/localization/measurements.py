"""Measurements for the Kalman filter, and how readings of wheel encoders and compass become measurements."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from envs.geometry import wrap_angle
from envs.robots import RobotParams

from .ekf_kernels import THETA, V, W, X, Y

Kind = Literal["map", "encoder", "compass"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""Kinds of measurement."""
MEASURED: dict[str, np.ndarray] = {
    "map": np.array([X, Y, THETA]),
    "encoder": np.array([V, W]),
    "compass": np.array([THETA, W]),
}
"""Entries of the state that each kind measures: the rows of H in equations (5), (7) and (9)."""
MIN_HEADING_STD = 1e-4
"""Standard deviation of a perfect compass [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Measurement of a part of the state."""

    time: float
    """When it was taken, by the clock that all measurements share [s]."""
    kind: Kind
    """Sensor: `map` (x, y, heading), `encoder` (speed, yaw rate) or `compass` (heading, yaw rate)."""
    values: np.ndarray
    """Shape (k,), float64 [m, rad, m/s, rad/s]; with NaN or infinity in it the measurement is `unusable`."""
    covariance: np.ndarray
    """Shape (k, k), float64, of the values' errors; symmetric and positive definite."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"unknown kind of measurement {self.kind!r}; choose one of {', '.join(KINDS)}")
        size = len(MEASURED[self.kind])
        if self.values.shape != (size,) or self.covariance.shape != (size, size):
            raise ValueError(
                f"a {self.kind} measurement has {size} values and a covariance of shape {(size, size)}, "
                f"got shapes {self.values.shape} and {self.covariance.shape}"
            )
        if not math.isfinite(self.time):
            raise ValueError(f"time of a measurement must be finite, got {self.time!r}")


def _elapsed(before: float, now: float, sensor: str) -> float:
    if not now > before:
        raise ValueError(f"time must go on between two {sensor} readings, got {now!r} s after {before!r} s")
    return now - before


class WheelMeter:
    """Turns encoder counts into speed and yaw rate, with the wheel radius and track of the robot's controller.

    Counts give the mean over the period since the last call, so the measurement's time is the middle of the period. Its
    covariance is that of two wheels with slip, whose counts are quantised at either end of the period.
    """

    def __init__(self, robot: RobotParams) -> None:
        self._metres_per_tick = robot.odometry.metres_per_tick
        self._track = robot.odometry.track
        self._slip_variance = robot.drive.slip_std**2

    def reset(self, time: float, ticks: tuple[int, int]) -> None:
        """Start from cumulative counts (left, right) at a time [s]."""
        self._time, self._ticks = time, ticks

    def update(self, time: float, ticks: tuple[int, int]) -> Measurement:
        """Return speed and yaw rate since the last call, from cumulative counts (left, right) at a time [s].

        Raises:
            ValueError: no time has passed since the last call.
        """
        period = _elapsed(self._time, time, "encoder")
        left, right = ((now - before) * self._metres_per_tick for now, before in zip(ticks, self._ticks))
        self._time, self._ticks = time, ticks
        quantisation = self._metres_per_tick**2 / 6.0
        left_variance, right_variance = (quantisation + self._slip_variance * abs(rolled) for rolled in (left, right))
        both, across = (left_variance + right_variance) / period**2, (right_variance - left_variance) / period**2
        track = self._track
        return Measurement(
            time - 0.5 * period,
            "encoder",
            np.array([0.5 * (left + right), (right - left) / track]) / period,
            np.array([[0.25 * both, 0.5 * across / track], [0.5 * across / track, both / track**2]]),
        )


class CompassMeter:
    """Turns compass readings into heading and yaw rate; the rate is the change of the heading since the last call."""

    def __init__(self, robot: RobotParams) -> None:
        imu = robot.imu
        # Rounding errors are uniform, with a standard deviation of step / sqrt(12).
        self._variance = imu.compass_std**2 + imu.compass_resolution**2 / 12.0 + MIN_HEADING_STD**2
        self._max_w, self._max_acc_w = robot.max_w, robot.max_acc_w

    def reset(self, time: float, north: float) -> None:
        """Start at a time [s]; `north` is what the compass reads in the direction of the map's x axis [rad]."""
        self._time, self._north = time, north
        self._heading = math.nan

    def update(self, time: float, reading: float) -> Measurement:
        """Return heading in the map frame and yaw rate from a reading [rad] at a time [s]; NaN gives NaN.

        Raises:
            ValueError: no time has passed since the last call.
        """
        period = _elapsed(self._time, time, "compass")
        heading = wrap_angle(reading - self._north)
        rate = wrap_angle(heading - self._heading) / period
        variance, lag = self._variance, 0.5 * self._max_acc_w * period
        rate_variance, common = 2.0 * variance / period**2 + lag**2 / 3.0, variance / period
        if math.isnan(rate) and not math.isnan(heading):
            rate, rate_variance, common = 0.0, self._max_w**2, 0.0
        self._time, self._heading = time, heading
        return Measurement(
            time, "compass", np.array([heading, rate]), np.array([[variance, common], [common, rate_variance]])
        )
