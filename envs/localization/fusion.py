"""Sensor fusion: one pose estimate from a localizer, wheel encoders and a compass."""

from collections import deque

import numpy as np

from envs.estimation import Belief
from envs.estimation.motion import WheelMotion
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.simulation import Reading

from .ekf import Ekf, EkfParams, Estimate
from .ekf_kernels import STATE_SIZE
from .localizer import Localizer
from .measurements import CompassMeter, Kind, Measurement, WheelMeter

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


def make_filter(robot: RobotParams) -> Ekf:
    """Return a Kalman filter whose process noise is the greatest acceleration of a robot."""
    return Ekf(EkfParams(acceleration=robot.max_acc_v, angular_acceleration=robot.max_acc_w))


def start_covariance(spread: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return the initial covariance of the filter for a robot at rest, shape (5, 5).

    `spread` is the standard deviation of the position along either axis [m], `turn` that of the heading [rad].
    """
    position, heading, v, w = MIN_START_STD
    return np.diag(np.square([max(spread, position)] * 2 + [max(turn, heading), v, w]))


class FusedPose:
    """Estimates a robot's pose from its sensors."""

    def __init__(self, robot: RobotParams, localizer: Localizer, fusion: str = "full", latency: float = 0.1) -> None:
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
        self.belief: Belief
        """The fused pose on the map."""
        self._kinds = FUSIONS[fusion]
        self._latency = latency
        self._has_compass = robot.imu.has_compass
        self._odometry, self._wheels, self._compass = WheelMotion(robot), WheelMeter(robot), CompassMeter(robot)
        self._delayed: deque[tuple[float, Measurement]] = deque()

    def reset(
        self,
        occupancy: OccupancyGrid,
        north: float,
        pose: Pose2D,
        reading: Reading,
        rng: np.random.Generator,
        covariance: np.ndarray,
    ) -> Estimate:
        """Start at rest on a map, at a pose of the base, map frame, with a covariance as from `start_covariance`.

        The compass reads `north` [rad] in the direction of the map's x axis; the localizer's noise comes from `rng`.
        """
        self._odometry.reset(reading)
        self._wheels.reset(reading.time, reading.ticks)
        self._compass.reset(reading.time, north)
        self._delayed.clear()
        self.localizer.reset(occupancy, pose, rng, covariance=covariance[:3, :3])
        self.localizer.update(reading.ranges, Pose2D(0.0, 0.0, 0.0))
        self.ekf.reset(pose, covariance, time=reading.time)
        self.measurements = []
        self.localized = Estimate(reading.time, pose, 0.0, 0.0, covariance)
        self.belief = Belief(pose, occupancy)
        return self.localized

    def update(self, reading: Reading) -> Estimate:
        """Update by a reading."""
        motion = self._odometry.update(reading)
        localized = self.localizer.update(reading.ranges, motion)
        wheels = self._wheels.update(reading.time, reading.ticks)
        self.measurements = [wheels]
        if self._has_compass:
            self.measurements.append(self._compass.update(reading.time, reading.heading))
        if localized.is_corrected and not localized.is_lost:
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
        self.belief.pose, self.belief.covariance = estimate.pose, estimate.covariance[:3, :3]
        self.belief.is_lost = localized.is_lost
        return estimate
