"""Sensor fusion: readings of wheel encoders and compass as measurements, and one pose estimate from these and a map."""

import math
from collections import deque

import numpy as np

from lidarnaut.envs.estimation import ORIGIN, Belief
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

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
    """Return a Kalman filter whose process noise is the greatest acceleration of a robot.

    All measurements have the clock of the readings, so that none is too new.
    """
    return Ekf(acceleration=robot.max_acc_v, angular_acceleration=robot.max_acc_w, max_ahead=math.inf)


def start_covariance(spread: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return the initial covariance of the filter for a robot at rest, shape (5, 5).

    `spread` is the standard deviation of the position along either axis [m], `turn` that of the heading [rad].
    """
    position, heading, v, w = MIN_START_STD
    return np.diag(np.square([max(spread, position)] * 2 + [max(turn, heading), v, w]))


def measure_wheels(robot: RobotParams, time: float, period: float, counts: tuple[int, int]) -> Measurement:
    """Return speed and yaw rate from encoder counts (left, right) during a period [s] that ends at a time [s].

    They are means, so the measurement's time is the middle of the period. Wheel radius and track are the controller's;
    the covariance is that of two wheels with slip, whose counts are quantised at either end of the period.
    """
    per_tick, track, slip = robot.odometry.metres_per_tick, robot.odometry.track, robot.drive.slip_std
    left, right = counts[0] * per_tick, counts[1] * per_tick
    left_variance, right_variance = (per_tick**2 / 6.0 + slip**2 * abs(rolled) for rolled in (left, right))
    both, across = (left_variance + right_variance) / period**2, (right_variance - left_variance) / period**2
    return Measurement(
        time - 0.5 * period,
        "encoder",
        np.array([0.5 * (left + right), (right - left) / track]) / period,
        np.array([[0.25 * both, 0.5 * across / track], [0.5 * across / track, both / track**2]]),
    )


def measure_heading(robot: RobotParams, time: float, period: float, before: float, heading: float) -> Measurement:
    """Return heading and yaw rate from the compass's headings at a time and a period [s] before, map frame [rad].

    NaN gives NaN; but if only the heading before is NaN, the rate is unknown.
    """
    imu = robot.imu
    # Rounding errors are uniform, with a standard deviation of step / sqrt(12).
    variance = imu.compass_std**2 + imu.compass_resolution**2 / 12.0 + MIN_HEADING_STD**2
    rate, lag = wrap_angle(heading - before) / period, 0.5 * robot.max_acc_w * period
    rate_variance, common = 2.0 * variance / period**2 + lag**2 / 3.0, variance / period
    if math.isnan(rate) and not math.isnan(heading):
        rate, rate_variance, common = 0.0, robot.max_w**2, 0.0
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
        self.north = math.nan
        """What the compass reads in the direction of the map's x axis [rad]; set it before a reset."""
        self._robot, self._kinds, self._latency = robot, FUSIONS[fusion], latency
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
        self._last: Reading | None = None
        self._delayed.clear()
        located = self.localizer.reset(rng, pose, map, np.diag(self._start[:3]))
        self.belief = Belief(pose, located.grid)
        return self.belief

    @property
    def particles(self) -> np.ndarray:
        """Particles of the localizer; see `Amcl`."""
        return self.localizer.particles

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Update by a reading; see `Estimator`.

        Raises:
            ValueError: no time has passed since the last reading.
        """
        last, self._last = self._last, reading
        if last is None:
            self.localizer.update(reading, ORIGIN)
            self.ekf.reset(self.belief.pose, np.diag(self._start), time=reading.time)
            self.measurements, self._heading = [], math.nan
            self.estimate = self.localized = Estimate(reading.time, self.belief.pose, 0.0, 0.0, np.diag(self._start))
            return self.belief
        period = reading.time - last.time
        if not period > 0.0:
            raise ValueError(f"time must go on between two readings, got {reading.time!r} s after {last.time!r} s")
        localized = self.localizer.update(reading, motion)
        counts = reading.ticks[0] - last.ticks[0], reading.ticks[1] - last.ticks[1]
        wheels = measure_wheels(self._robot, reading.time, period, counts)
        self.measurements = [wheels]
        if self._robot.imu.has_compass:
            before, self._heading = self._heading, wrap_angle(reading.heading - self.north)
            self.measurements.append(measure_heading(self._robot, reading.time, period, before, self._heading))
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
        belief.rivals = localized.rivals
        return belief
