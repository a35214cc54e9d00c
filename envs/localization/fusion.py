"""Sensor fusion: readings of wheel encoders and compass as measurements, and one pose estimate from these and a map."""

import math
from collections import deque

import numpy as np

from envs.estimation import ORIGIN, Belief
from envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

from .amcl import Amcl
from .ekf import STATE_SIZE, Ekf, Estimate, Kind, Measurement

FUSIONS: dict[str, tuple[Kind, ...]] = {
    "encoder": ("encoder",),
    "encoder_compass": ("encoder", "compass"),
    "amcl": (),
    "full": ("map", "encoder", "compass"),
}
"""Kinds of measurement that the filter uses, by the name of the fusion. `amcl` is the localizer's own pose, unfiltered,
which follows odometry between two corrections."""
MIN_START_STD = (0.01, 0.005, 0.01, 0.01)
"""Least standard deviations of position, heading, speed and yaw rate at the start [m, rad, m/s, rad/s]."""
MAP_STD = (0.025, 0.025, 0.003)
"""Standard deviations of x, y and heading [m, m, rad], added to those of the localizer's estimates, whose errors are
correlated: where the map is 6 mm off, all of them are. With this much the filter is consistent (NEES)."""
MIN_HEADING_STD = 1e-4
"""Standard deviation of a perfect compass [rad]."""


def make_filter(robot: RobotParams) -> Ekf:
    """Return a Kalman filter whose process noise is the greatest acceleration of a robot."""
    return Ekf(acceleration=robot.max_acc_v, angular_acceleration=robot.max_acc_w)


def start_covariance(spread: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return the initial covariance of the filter for a robot at rest, shape (5, 5).

    `spread` is the standard deviation of the position along either axis [m], `turn` that of the heading [rad].
    """
    position, heading, v, w = MIN_START_STD
    return np.diag(np.square([max(spread, position)] * 2 + [max(turn, heading), v, w]))


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


class FusedPose:
    """Estimates a robot's pose from its sensors."""

    def __init__(self, robot: RobotParams, localizer: Amcl, fusion: str = "full", latency: float = 0.1) -> None:
        """Fuse, by one of `FUSIONS`, a robot's sensors and a localizer whose estimates come `latency` [s] late.

        Raises:
            ValueError: the fusion is unknown, or the robot lacks the compass that it needs.
        """
        if fusion not in FUSIONS:
            raise ValueError(f"unknown fusion {fusion!r}; choose one of {', '.join(FUSIONS)}")
        if fusion == "encoder_compass" and not robot.imu.has_compass:
            raise ValueError(f"fusion {fusion!r} needs a compass, and robot {robot.name!r} has none")
        self.localizer = localizer
        self.ekf = make_filter(robot)
        self.measurements: list[Measurement] = []
        """Measurements that arrived with the last reading, of all kinds, be they used by the fusion or not."""
        self.localized: Estimate
        """The localizer's own estimate at the last reading, with speeds from the encoders."""
        self.estimate: Estimate
        """The fused pose and velocity."""
        self.belief: Belief
        """The fused pose on the map."""
        self._kinds = FUSIONS[fusion]
        self._latency = latency
        self._has_compass = robot.imu.has_compass
        self.north = math.nan
        """What the compass reads in the direction of the map's x axis [rad]; set it before a reset."""
        self._wheels, self._compass = WheelMeter(robot), CompassMeter(robot)
        self._delayed: deque[tuple[float, Measurement]] = deque()

    def reset(
        self,
        rng: np.random.Generator,
        pose: Pose2D = ORIGIN,
        map: OccupancyGrid | None = None,
        covariance: np.ndarray | None = None,
    ) -> Belief:
        """Start at rest on a map; see `Estimator` and `Amcl`. The first reading that follows is that of the start."""
        self._start = np.diag(start_covariance()).copy()
        if covariance is not None:
            self._start[:3] = np.diag(covariance)
        self._has_begun = False
        self._delayed.clear()
        located = self.localizer.reset(rng, pose, map, np.diag(self._start[:3]))
        self.belief = Belief(pose, located.grid)
        return self.belief

    @property
    def particles(self) -> np.ndarray:
        """Particles of the localizer; see `Amcl`."""
        return self.localizer.particles

    def _begin(self, reading: Reading) -> Belief:
        """Process the reading of the start."""
        self._has_begun = True
        covariance = np.diag(self._start)
        self._wheels.reset(reading.time, reading.ticks)
        self._compass.reset(reading.time, self.north)
        self.localizer.update(reading, ORIGIN)
        self.ekf.reset(self.belief.pose, covariance, time=reading.time)
        self.measurements = []
        self.estimate = self.localized = Estimate(reading.time, self.belief.pose, 0.0, 0.0, covariance)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Update by a reading; see `Estimator`."""
        if not self._has_begun:
            return self._begin(reading)
        localized = self.localizer.update(reading, motion)
        wheels = self._wheels.update(reading.time, reading.ticks)
        self.measurements = [wheels]
        if self._has_compass:
            self.measurements.append(self._compass.update(reading.time, reading.heading))
        if self.localizer.is_corrected and not localized.is_lost:
            covariance = localized.covariance + np.diag(np.square(MAP_STD))
            measurement = Measurement(reading.time, "map", np.array(localized.pose), covariance)
            self._delayed.append((reading.time + self._latency, measurement))
        while self._delayed and self._delayed[0][0] <= reading.time + 1e-9:
            self.measurements.append(self._delayed.popleft()[1])
        covariance = np.zeros((STATE_SIZE, STATE_SIZE))
        covariance[:3, :3], covariance[3:, 3:] = localized.covariance, wheels.covariance
        v, w = wheels.values.tolist()
        self.localized = Estimate(reading.time, localized.pose, v, w, covariance)
        for measurement in self.measurements:
            if measurement.kind in self._kinds:
                self.ekf.add(measurement)
        estimate = self.ekf.estimate(reading.time) if self._kinds else self.localized
        self.estimate, belief = estimate, self.belief
        belief.pose, belief.covariance = estimate.pose, estimate.covariance[:3, :3]
        belief.twist, belief.is_lost = Twist(estimate.v, estimate.w), localized.is_lost
        return belief
