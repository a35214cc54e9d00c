"""One pose out of everything that a robot senses: a localiser, wheels and a compass, fused by name."""

from collections import deque

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams, WheelOdometry
from envs.simulation import Reading

from .ekf import Ekf, EkfParams, Estimate, Kind, Measurement
from .ekf_kernels import STATE_SIZE
from .localizer import Localizer
from .measurements import CompassMeter, WheelMeter

FUSIONS: dict[str, tuple[Kind, ...]] = {
    "encoder": ("encoder",),
    "encoder_compass": ("encoder", "compass"),
    "amcl": (),
    "full": ("map", "encoder", "compass"),
}
"""Names of fusions, and the kinds of measurement that the filter listens to. `amcl` filters nothing: it is the
localiser's own pose, which moves along with odometry between two corrections."""
LEAST_START_STD = (0.01, 0.005, 0.01, 0.01)
"""How well a start is known at best: standard deviations of position, heading, speed, yaw rate [m, rad, m/s, rad/s]."""
LEAST_MAP_STD = (0.025, 0.025, 0.003)
"""Standard deviations of x, y and heading [m, m, rad] that are added to those of a localiser's answer. Answers are not
independent: where the map is 6 mm off they all are, and a filter that averages hundreds of them must not come to
believe that it knows better. With this much, errors are as large as the filter says."""


def make_filter(robot: RobotParams) -> Ekf:
    """Return a Kalman filter for a robot, which may speed up or slow down at any time by as much as it can."""
    return Ekf(EkfParams(acceleration=robot.max_acc_v, angular_acceleration=robot.max_acc_w))


def start_covariance(spread: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return how well the start of a robot at rest is known, shape (5, 5), for the filter.

    Args:
        spread: standard deviation of its position along either axis [m].
        turn: standard deviation of its heading [rad].
    """
    position, heading, v, w = LEAST_START_STD
    return np.diag(np.square([max(spread, position)] * 2 + [max(turn, heading), v, w]))


class FusedPose:
    """Where a robot takes itself to be. Never sees the truth."""

    def __init__(self, robot: RobotParams, localizer: Localizer, fusion: str = "full", latency: float = 0.1) -> None:
        """Prepare for a robot.

        Args:
            robot: whose sensors are read.
            localizer: finds the robot on the map.
            fusion: one of `FUSIONS`.
            latency: how late the localiser's answers reach the filter [s].

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
        """What has become known with the last reading, of every kind and whether the filter listens to it or not."""
        self.located: Estimate
        """The localiser's own answer to the last reading, with speeds by the encoders."""
        self._kinds = FUSIONS[fusion]
        self._latency = latency
        self._has_compass = robot.imu.has_compass
        self._odometry, self._wheels, self._compass = WheelOdometry(robot), WheelMeter(robot), CompassMeter(robot)
        self._on_the_way: deque[tuple[float, Measurement]] = deque()

    def reset(
        self,
        occupancy: OccupancyGrid,
        north: float,
        pose: Pose2D,
        reading: Reading,
        rng: np.random.Generator,
        covariance: np.ndarray,
    ) -> Estimate:
        """Start at rest on a map.

        Args:
            occupancy: the map.
            north: what the compass reads in the direction of the map's x axis [rad].
            pose: where the robot is, map frame.
            reading: the first.
            rng: noise of the localiser is drawn from it.
            covariance: how well the start is known, see `start_covariance`.
        """
        self._odometry.reset(reading.ticks)
        self._wheels.reset(reading.time, reading.ticks)
        self._compass.reset(reading.time, north)
        self._on_the_way.clear()
        self.localizer.reset(occupancy, pose, rng, covariance=covariance[:3, :3])
        self.localizer.update(reading.ranges, Pose2D(0.0, 0.0, 0.0))
        self.ekf.reset(pose, covariance, time=reading.time)
        self.measurements = []
        self.located = Estimate(reading.time, pose, 0.0, 0.0, covariance)
        return self.located

    def update(self, reading: Reading) -> Estimate:
        """Take in a reading and say where the robot is."""
        motion = self._odometry.update(reading.ticks)
        located = self.localizer.update(reading.ranges, motion)
        wheels = self._wheels.update(reading.time, reading.ticks)
        self.measurements = [wheels]
        if self._has_compass:
            self.measurements.append(self._compass.update(reading.time, reading.heading))
        if located.is_corrected and not located.is_lost:
            covariance = located.covariance + np.diag(np.square(LEAST_MAP_STD))
            found = Measurement(reading.time, "map", np.array(located.pose), covariance)
            self._on_the_way.append((reading.time + self._latency, found))
        while self._on_the_way and self._on_the_way[0][0] <= reading.time + 1e-9:
            self.measurements.append(self._on_the_way.popleft()[1])
        both = np.zeros((STATE_SIZE, STATE_SIZE))
        both[:3, :3], both[3:, 3:] = located.covariance, wheels.covariance
        v, w = wheels.values.tolist()
        self.located = Estimate(reading.time, located.pose, v, w, both)
        if not self._kinds:
            return self.located
        for measurement in self.measurements:
            if measurement.kind in self._kinds:
                self.ekf.add(measurement)
        return self.ekf.estimate(reading.time)
