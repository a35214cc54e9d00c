"""One robot: its readings, its estimates of pose and map, and the path that it took."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from envs.estimation import ORIGIN, Belief, Estimator
from envs.estimation.belief import check_belief
from envs.estimation.map_pyramid import MapPyramid
from envs.estimation.motion import MotionSource
from envs.estimation.peers import PeerFilter
from envs.estimation.trail import Trail, interpolate
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


class Prior(NamedTuple):
    """What a robot is told at the start of an episode."""

    pose: Pose2D | None = ORIGIN
    """Of the base, map frame; None for global localization on a known map."""
    map: OccupancyGrid | None = None
    """The known map; None for an unknown one."""
    covariance: np.ndarray | None = None
    """Shape (3, 3), float64: of the pose [m, m, rad]; None for the estimator's own."""


class Robot:
    """A robot with its sensors, odometry and estimator. Holds no ground truth.

    What `ground_truth` tells it of its motion, where users ask for `slam="truth"`, reaches the estimator alone.
    """

    def __init__(
        self,
        params: RobotParams,
        control_period: float,
        estimator: Estimator,
        odometry: MotionSource,
        ground_truth: MotionSource | None = None,
    ) -> None:
        """Assemble a robot.

        Args:
            params: the robot.
            control_period: time between two readings [s].
            estimator: turns readings and motions into a belief.
            odometry: motion by the robot's own sensors.
            ground_truth: motion that the estimator gets instead; None for odometry.
        """
        self.params = params
        self.estimator = estimator
        kind = type(estimator)  # checks of the project's own would take a twentieth of a kinematic step
        self._own_estimator = "" if kind.__module__.startswith("envs.") else kind.__name__
        self.odometry = odometry
        self.ground_truth = ground_truth
        self.control_period = control_period
        """Time between two readings [s]."""
        self.peers: list[Robot] = []
        """The other robots of a team, which tell this one their poses."""
        self._peer_filter = PeerFilter(params)

    @property
    def belief(self) -> Belief:
        """Pose estimate and map."""
        return self.estimator.belief

    def reset(self, reading: Reading, prior: Prior, rng: np.random.Generator, shared_map: Any = None) -> None:
        """Begin an episode at rest; `locate` processes the reading's scan.

        Args:
            reading: the first.
            prior: what the robot is told.
            rng: source of the estimator's noise.
            shared_map: map that another robot of the team integrates its scans into; None without one.
        """
        told = {} if prior.covariance is None else {"covariance": prior.covariance}
        self.estimator.reset(rng, prior.pose, prior.map if shared_map is None else shared_map, **told)
        self.reading = reading
        self.twist = Twist(0.0, 0.0)
        """Velocity by odometry, or by the estimator where it gives one."""
        self.action = (0.0, 0.0)
        """The last action: forward speed and yaw rate over their limits."""
        self.collisions = 0
        """Contacts so far."""
        self.motion = ORIGIN
        """Motion of the base during the last period, as the estimator learns of it."""
        self.predicted_pose = self.belief.pose
        """Pose estimate before the last scan was processed, and with it once it is."""
        self.odometry.reset(reading)
        if self.ground_truth is not None:
            self.ground_truth.reset(reading)
        self.trail = Trail()
        """Estimated positions so far, map frame."""
        self.pyramid = MapPyramid(self.belief.grid, [self.trail])
        """The map at the scales of observations."""
        self._data = self.belief.grid.data, self.belief.grid.data.shape

    def sense(self, reading: Reading) -> None:
        """Process a reading but for its scan: odometry and bumper."""
        self.collisions += reading.bumper and not self.reading.bumper
        self.reading = reading
        motion = self.odometry.update(reading)
        self.twist = Twist(motion.x / self.control_period, motion.theta / self.control_period)
        self.motion = motion if self.ground_truth is None else self.ground_truth.update(reading)
        if self.peers:
            self.predicted_pose = self.belief.pose.compose(self.motion)

    def locate(self) -> None:
        """Process the reading's scan: pose, map and trail.

        Raises:
            ValueError: no map can be made of the belief; see `check_belief`.
        """
        reading = self.reading
        if self.peers:
            peers = [peer.predicted_pose for peer in self.peers]
            reading = reading._replace(ranges=self._peer_filter(reading.ranges, self.predicted_pose, peers))
        belief = self.estimator.update(reading, self.motion)
        if self._own_estimator:
            check_belief(belief, self._own_estimator, self.pyramid.grid, self._data)
            self._data = belief.grid.data, belief.grid.data.shape
        self.follow(belief)

    def follow(self, belief: Belief) -> None:
        """Bring trail and pyramid up to date with the belief after a scan."""
        self.predicted_pose = belief.pose
        if belief.twist is not None:
            self.twist = belief.twist
        if belief.update.redrawn and belief.path is not None:
            self.trail.replace(interpolate(belief.path[:, :2]))
        self.pyramid.update(belief.update)
        if self.trail.append(belief.pose):
            self.pyramid.mark(belief.pose.x, belief.pose.y)


def reset_robots(
    robots: Sequence[Robot],
    readings: Sequence[Reading],
    priors: Sequence[Prior],
    rngs: Sequence[np.random.Generator],
) -> None:
    """Begin an episode of one robot, or of several that share a map, and process the first scans.

    Args:
        robots: all robots.
        readings: their first ones.
        priors: what they are told.
        rngs: sources of their estimators' noise.
    """
    shared_map = None
    for robot, reading, prior, rng in zip(robots, readings, priors, rngs, strict=True):
        robot.reset(reading, prior, rng, shared_map)
        shared_map = getattr(robot.estimator, "map", None)
    if len(robots) > 1:
        pyramid = MapPyramid(robots[0].belief.grid, [robot.trail for robot in robots])
        for robot in robots:
            robot.pyramid = pyramid
    for robot in robots:
        if getattr(robot.estimator, "uses_first_scan", True):
            robot.locate()
        else:
            robot.trail.append(robot.belief.pose)
