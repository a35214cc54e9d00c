"""Sensor fusion of wheel encoders, compass and map localization."""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from lidarnaut.envs.estimation import Belief, Estimator
from lidarnaut.envs.geometry import ORIGIN, OccupancyGrid, Pose2D, wrap_angle
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

from .amcl import Amcl
from .ekf import DRIFT, NUM_REPORTED, TURN_HOLD, Ekf, Estimate, Kind, Measurement

FUSIONS: dict[str, tuple[Kind, ...]] = {
    "encoder": ("encoder",),
    "encoder_compass": ("encoder", "compass"),
    "amcl": (),
    "full": ("map", "encoder", "compass"),
}
"""Sensors that the Kalman filter fuses, by name of the combination; none for `amcl`, which is AMCL without filter."""
MIN_START_STD = (0.01, 0.005, 0.01, 0.01)
"""Minimum standard deviation of the initial position, heading, speed, yaw rate [m, rad, m/s, rad/s]."""
START_ACCELERATION = 0.16
"""Minimum standard deviation of the initial speed, divided by the greatest change of speed in a period. A start at full
acceleration has a mean speed of 0.5 in this unit, which must not be `gated`."""
MAP_STD, MAP_HEADING_STD = 1.0, 0.001
"""Extra standard deviation of AMCL poses in the Kalman filter, as successive errors are correlated: position [map
cells], heading [rad]."""
BIAS_STD, BIAS_DRIFT = 1.0, 0.1
"""Assumed bias of the compass in standard deviations of its noise: standard deviation at the start, and root spectral
density of its random walk [1/sqrt(s)]."""
MIN_ACCELERATION_TIME = 0.06
"""Minimum assumed duration of an acceleration at the limit of the robot [s]; otherwise the period of the readings."""
COMPASS_FACTOR = 4.0
"""Factor of the variance of compass headings: 2, as each heading is part of two measurements, and a margin of 2."""
MIN_HEADING_STD = 1e-4
"""Minimum standard deviation of compass headings [rad]."""


def make_filter(robot: RobotParams, period: float) -> Ekf:
    """Return an extended Kalman filter with process noise from the robot's acceleration limits.

    `period`: time between two measurements of the encoders [s].
    """
    root = max(period, MIN_ACCELERATION_TIME) / math.sqrt(period)
    noise = math.sqrt(compass_variance(robot)) if robot.imu.has_compass else 0.0
    # At an acceleration a, the heading differs from that at a constant yaw rate by up to a period^2.
    across = robot.max_v * robot.max_acc_w * period**2.5
    return Ekf(
        acceleration=root * robot.max_acc_v,
        angular_acceleration=root * robot.max_acc_w,
        horizon=max(1.0, 3.0 * period),
        max_ahead=math.inf,
        bias_std=BIAS_STD * noise,
        bias_drift=BIAS_DRIFT * noise,
        drift=math.hypot(DRIFT[0], across),
        turn_hold=max(TURN_HOLD, period),
    )


def compass_variance(robot: RobotParams) -> float:
    """Return the variance of one compass heading by noise and rounding [rad2]."""
    # Variance of uniform rounding errors: step^2 / 12.
    return robot.imu.compass_std**2 + robot.imu.compass_resolution**2 / 12.0 + MIN_HEADING_STD**2


def start_covariance(spread: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return the initial covariance of x, y, heading, speed and yaw rate at rest, shape (5, 5).

    `spread`: standard deviation of position per axis [m]. `turn`: of heading [rad].
    """
    position, heading, v, w = MIN_START_STD
    return np.diag(np.square([max(spread, position)] * 2 + [max(turn, heading), v, w]))


def measure_wheels(robot: RobotParams, time: float, period: float, counts: tuple[int, int]) -> Measurement:
    """Return mean speed and yaw rate from encoder `counts` (left, right) in the `period` [s] before `time` [s].

    The time stamp is the beginning of the period: the filter predicts at constant speeds from there.
    """
    per_tick, track, slip = robot.odometry.metres_per_tick, robot.odometry.track, robot.drive.slip_std
    left, right = counts[0] * per_tick, counts[1] * per_tick
    left_variance, right_variance = (per_tick**2 / 6.0 + slip**2 * abs(rolled) for rolled in (left, right))
    both, across = (left_variance + right_variance) / period**2, (right_variance - left_variance) / period**2
    return Measurement(
        time - period,
        "encoder",
        np.array([0.5 * (left + right), (right - left) / track]) / period,
        np.array([[0.25 * both, 0.5 * across / track], [0.5 * across / track, both / track**2]]),
    )


def measure_heading(robot: RobotParams, time: float, period: float, before: float, heading: float) -> Measurement:
    """Return heading and yaw rate from compass headings at `time` [s] and a `period` [s] before, map frame [rad].

    Without earlier heading (NaN), the yaw rate gets a large variance.
    """
    variance = COMPASS_FACTOR * compass_variance(robot)
    rate, lag = wrap_angle(heading - before) / period, robot.max_acc_w * period
    rate_variance, common = 2.0 * variance / period**2 + lag**2, variance / period
    if math.isnan(rate) and not math.isnan(heading):
        rate, rate_variance, common = 0.0, robot.max_w**2, 0.0
    return Measurement(
        time, "compass", np.array([heading, rate]), np.array([[variance, common], [common, rate_variance]])
    )


class FusedPose(Estimator):
    """Estimator that fuses AMCL, wheel encoders and compass by a Kalman filter."""

    def __init__(
        self, robot: RobotParams, period: float, localizer: Amcl, fusion: str = "full", latency: float = 0.1
    ) -> None:
        """Create the estimator.

        Args:
            robot: parameters of the robot.
            period: control period, the time between two readings of encoders and compass [s].
            localizer: AMCL, whose poses are measurements of the filter.
            fusion: sensors (key of `FUSIONS`).
            latency: delay of AMCL's poses [s].

        Raises:
            ValueError: unknown fusion, or a fusion of the compass for a robot without one.
        """
        if fusion not in FUSIONS:
            raise ValueError(f"unknown fusion {fusion!r}; choose one of {', '.join(FUSIONS)}")
        if fusion == "encoder_compass" and not robot.imu.has_compass:
            raise ValueError(f"fusion {fusion!r} needs a compass, and robot {robot.name!r} has none")
        self.localizer = localizer
        self.ekf = make_filter(robot, period)
        self.measurements: list[Measurement] = []
        """Measurements received at the last `update`, including those that the filter does not use."""
        self.localized: Estimate
        """Unfiltered estimate at the last `update`: last received AMCL pose and the odometry since then; speed and yaw
        rate by encoders."""
        self.estimate: Estimate
        self.north = math.nan
        """Compass heading of the map's x axis [rad]; set before `reset`."""
        self.pivot = ORIGIN
        """Point of the base without sideslip; set before `reset`. `ekf` and map measurements hold its poses."""
        self._start_v = START_ACCELERATION * robot.max_acc_v * period
        self._robot, self._kinds, self._latency = robot, FUSIONS[fusion], latency
        self._delayed: deque[tuple[float, Measurement, Pose2D]] = deque()

    def reset(
        self,
        rng: np.random.Generator,
        pose: Pose2D = ORIGIN,
        map: OccupancyGrid | None = None,
        covariance: np.ndarray | None = None,
    ) -> Belief:
        """Start at rest on a known map. The first call of `update` must pass the sensor reading at the start."""
        self._start = np.diag(start_covariance()).copy()
        if covariance is not None:
            self._start[:3] = np.diag(covariance)
        self._start[3] = max(self._start[3], self._start_v**2)
        self._last: Reading | None = None
        self._delayed.clear()
        self._odometry, self._odometry_frame = ORIGIN, pose
        located = self.localizer.reset(rng, pose, map, np.diag(self._start[:3]))
        self.belief = Belief(pose, located.grid)
        return self.belief

    @property
    def particles(self) -> np.ndarray:  # type: ignore[override]
        return self.localizer.particles

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Update the estimate by a sensor reading; `motion`: base pose by odometry relative to the last reading.

        Raises:
            ValueError: time stamps do not increase.
        """
        last, self._last = self._last, reading
        motion = self.pivot.compose(motion).compose(self.pivot.inverse()) if last else ORIGIN
        localized, self._odometry = self.localizer.update(reading, motion), self._odometry.compose(motion)
        if self.localizer.is_corrected and not localized.is_lost:
            error = MAP_STD * localized.grid.resolution
            covariance = localized.covariance + np.diag(np.square([error, error, MAP_HEADING_STD]))
            measurement = Measurement(reading.time, "map", np.array(localized.pose.compose(self.pivot)), covariance)
            self._delayed.append((reading.time + self._latency, measurement, self._odometry.compose(self.pivot)))
        if last is None:
            self.ekf.reset(self.belief.pose.compose(self.pivot), np.diag(self._start), time=reading.time)
            self.measurements, self._heading = [], math.nan
            self.estimate = self.localized = Estimate(reading.time, self.belief.pose, 0.0, 0.0, np.diag(self._start))
            return self.belief
        period = reading.time - last.time
        if not period > 0.0:
            raise ValueError(f"time must increase between readings, got {reading.time!r} s after {last.time!r} s")
        counts = reading.ticks[0] - last.ticks[0], reading.ticks[1] - last.ticks[1]
        wheels = measure_wheels(self._robot, reading.time, period, counts)
        self.measurements = [wheels]
        if self._robot.imu.has_compass:
            before, self._heading = self._heading, wrap_angle(reading.heading - self.north)
            self.measurements.append(measure_heading(self._robot, reading.time, period, before, self._heading))
        while self._delayed and self._delayed[0][0] <= reading.time + 1e-9:
            _, measurement, odometry = self._delayed.popleft()
            self.measurements.append(measurement)
            self._odometry_frame = Pose2D(*measurement.values).compose(odometry.inverse())
        covariance = np.zeros((NUM_REPORTED, NUM_REPORTED))
        covariance[:3, :3], covariance[3:, 3:] = localized.covariance, wheels.covariance
        v, w = wheels.values.tolist()
        self.localized = Estimate(reading.time, self._odometry_frame.compose(self._odometry), v, w, covariance)
        for measurement in self.measurements:
            if measurement.kind in self._kinds:
                self.ekf.add(measurement)
        estimate, belief = self.localized, self.belief
        if self._kinds:
            estimate = self.ekf.estimate(reading.time)
            estimate = replace(estimate, pose=estimate.pose.compose(self.pivot.inverse()))
        self.estimate = estimate
        belief.pose, belief.covariance = estimate.pose, estimate.covariance[:3, :3]
        belief.twist, belief.is_lost = Twist(estimate.v, estimate.w), localized.is_lost
        belief.rivals = localized.rivals
        return belief
