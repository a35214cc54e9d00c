"""Sensor fusion: one pose estimate from a localizer, wheel encoders and a compass."""

import math
from collections import deque

import numpy as np

from envs.estimation import ORIGIN, Belief
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

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
        """Start at rest on a map; see `Estimator`. The first reading that follows is that of the start.

        Raises:
            ValueError: there is no map.
        """
        if map is None:
            raise ValueError("localization needs a map")
        self._start = np.diag(start_covariance()).copy()
        if covariance is not None:
            self._start[:3] = np.diag(covariance)
        self._has_begun = False
        self._delayed.clear()
        self.localizer.reset(map, pose, rng, covariance=np.diag(self._start[:3]))
        self.belief = Belief(pose, map)
        return self.belief

    def _begin(self, reading: Reading) -> Belief:
        """Process the reading of the start."""
        self._has_begun = True
        covariance = np.diag(self._start)
        self._wheels.reset(reading.time, reading.ticks)
        self._compass.reset(reading.time, self.north)
        self.localizer.update(reading.ranges, ORIGIN)
        self.ekf.reset(self.belief.pose, covariance, time=reading.time)
        self.measurements = []
        self.estimate = self.localized = Estimate(reading.time, self.belief.pose, 0.0, 0.0, covariance)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Update by a reading; see `Estimator`."""
        if not self._has_begun:
            return self._begin(reading)
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
        self.estimate, belief = estimate, self.belief
        belief.pose, belief.covariance = estimate.pose, estimate.covariance[:3, :3]
        belief.twist, belief.is_lost = Twist(estimate.v, estimate.w), localized.is_lost
        return belief
