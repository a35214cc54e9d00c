"""Sensor readings, estimates and ground truth of a robot."""

import math
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.estimation import NO_UPDATE, Belief, DeadReckoning, Estimator
from lidarnaut.envs.estimation.belief import check_belief
from lidarnaut.envs.estimation.map_pyramid import MapPyramid
from lidarnaut.envs.estimation.scan_points import BODY_MARGIN, ScanGeometry, are_on_bodies, as_bodies, scan_ends
from lidarnaut.envs.estimation.tracking import PeopleTracker
from lidarnaut.envs.estimation.trail import Trail, interpolate
from lidarnaut.envs.files import with_defaults
from lidarnaut.envs.geometry import ORIGIN, OccupancyGrid, Pose2D
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, RobotState, Twist
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.rows import Rows
from lidarnaut.envs.slam.key_scans import KeyScanSlam

SCAN, REMEMBER, REMEMBER_TRUE = 1, 2, 4
"""Bit flags in a robot's state: process the scan, record the estimated position, record the true position."""
ONE_ACTIVE = np.ones(1, dtype=np.bool_)
MAX_PERSON_GAP, MAX_TIME_TO_COLLISION = 10.0, 10.0
"""Upper limits of the recorded gap to people [m] and time to collision [s]."""


class Prior(NamedTuple):
    """Initial pose and map of a robot."""

    pose: Pose2D | None = ORIGIN
    """Initial pose of the base, map frame; None for global localization on a known map."""
    map: OccupancyGrid | None = None
    """Known map; None if the map is unknown."""
    covariance: np.ndarray | None = None
    """Covariance of the initial pose, shape (3, 3), float64 [m, m, rad]; None for the estimator's default."""


class Robot:
    """Robot with sensors, odometry, and an estimator of pose and map.

    Its state is a row of the robot state table `Rows`. Public attributes contain no ground truth.
    """

    def __init__(
        self, params: RobotParams, control_period: float, estimator: Estimator, *, uses_true_motion: bool = False
    ) -> None:
        """Create a robot; with `uses_true_motion` the estimator receives the true motion instead of odometry."""
        self.params = params
        self.estimator = with_defaults(estimator, Estimator)
        kind = type(estimator)  # checks would take 5 % of a kinematic step
        self._own_estimator = "" if kind.__module__.startswith("lidarnaut.envs.") else kind.__name__
        self.control_period = control_period
        self.peers: Sequence[Robot] = ()
        """Other robots of a team; their pose estimates are shared."""
        self._geometry = ScanGeometry.of(params.lidar)
        self.tracker: PeopleTracker | None = None
        """Tracker that excludes people from the map; None without tracking."""
        least = math.inf, math.inf  # dead reckoning has no key scans
        if not self.estimator.follows_odometry:
            least = -1.0, 0.0
        elif isinstance(estimator, KeyScanSlam):
            least = estimator.params.min_travel_distance, estimator.params.min_travel_angle
        self._reading: Reading
        self._planners: dict[Hashable, Any] = {}
        self._setup = at.MotionSettings(float(uses_true_motion), *least)

    @property
    def belief(self) -> Belief:
        """Pose estimate and map."""
        return self.estimator.belief

    @property
    def _row(self) -> Any:
        return self._rows.numbers[self.index]

    @property
    def row(self) -> np.void:
        """Copy of the robot's record, dtype `ROW`; fields with ground truth are NaN."""
        numbers = self._rows.numbers[self.index : self.index + 1]
        row: np.void = (at.SENSED * numbers.view(np.float64)).view(numbers.dtype)[0]
        row["touched"] = row["touched"] > 0.0
        return row

    def as_rows(self, truth: "GroundTruth | None" = None) -> RobotRows:
        """Return this robot alone as `RobotRows`; without `truth`, ground truth in its record is NaN."""
        rows, own = self._rows, slice(self.index, self.index + 1)
        memory = {name: kept[own] for name, kept in rows.memory.items()}
        numbers = np.array([self.row]) if truth is None else rows.numbers[own]
        return RobotRows([self], numbers, rows.ranges[own], memory)

    def remember(self, name: Hashable, size: int, dtype: Any = np.float64) -> np.ndarray:
        """Return the data that an observation stores as `name`, shape (size,); see `Rows.remember`."""
        row: np.ndarray = self._rows.remember(name, size, dtype)[self.index]
        return row

    def planner(self, name: Hashable, make: Callable[[], Any]) -> Any:
        """Return the planner `name`, which observation parts and policies share; `make` creates it in each episode."""
        if name not in self._planners:
            self._planners[name] = make()
        return self._planners[name]

    @property
    def reading(self) -> Reading:
        """Last sensor reading."""
        if self._reading.time != self._rows.numbers["time"][self.index]:
            self._reading = self._rows.reading(self.index)
        return self._reading

    @reading.setter
    def reading(self, reading: Reading) -> None:
        self._reading = reading

    @property
    def ranges(self) -> np.ndarray:
        """Ranges of the last scan, shape (num_beams,), float32 [m]; overwritten by the next scan."""
        return self._rows.ranges[self.index]

    @property
    def bumper(self) -> bool:
        """Whether the body touched anything during the last control period."""
        return bool(self._rows.numbers["touched"][self.index] > 0.0)

    @property
    def twist(self) -> Twist:
        """Velocity [m/s, rad/s] from the estimator if available, otherwise from odometry."""
        return Twist(*self._rows.numbers["twist"][self.index].tolist())

    @property
    def action(self) -> tuple[float, float]:
        """Last action: forward speed and yaw rate as fractions of their limits."""
        return float(self._row["action_v"]), float(self._row["action_w"])

    @action.setter
    def action(self, action: tuple[float, float]) -> None:
        self._row["action_v"], self._row["action_w"] = action

    @property
    def collisions(self) -> int:
        return int(self._row["collisions"])

    @property
    def motion(self) -> Pose2D:
        """Motion (x, y, theta) of the base in the last control period [m, rad], given to the estimator."""
        return Pose2D(*self._row["motion"].tolist())

    @property
    def predicted_pose(self) -> Pose2D:
        """Pose estimate, map frame [m, rad]: that of the last processed scan, extrapolated by odometry."""
        return Pose2D(*self._rows.numbers["pose"][self.index].tolist())

    def reset(
        self, rows: Rows, index: int, reading: Reading, prior: Prior, rng: np.random.Generator, shared_map: Any = None
    ) -> None:
        """Start an episode with the robot at rest; `integrate` then processes the first scan.

        `rows`: state table of all robots; `index`: this robot's row. `rng`: random generator of the estimator.
        `shared_map`: map that the robots of a team share, or None.
        """
        told = {} if prior.covariance is None else {"covariance": prior.covariance}
        self.estimator.reset(rng, prior.pose, prior.map if shared_map is None else shared_map, **told)
        self.belief.grows = prior.map is None
        self._rows, self.index, self._planners = rows, index, {}
        self.has_known_map = prior.map is not None
        self.reading, row = reading, self._row
        self.trail = Trail()
        """Path of estimated positions, map frame [m]."""
        self.pyramid = MapPyramid(self.belief.grid, [self.trail])
        """Map at several resolutions, for observations."""
        self._data = self.belief.grid.data, self.belief.grid.data.shape
        row["motion_settings"], row["key_pose"][0] = self._setup, np.inf
        row["pose"] = self.belief.pose
        if self._setup.min_travel_distance == math.inf:
            row["key_pose"] = self.belief.pose
        row["last_pose"], row["last_touched"] = (row["x"], row["y"], row["theta"]), row["touched"]
        row["person_gap"], row["least_gap"], row["least_time"] = MAX_PERSON_GAP, MAX_PERSON_GAP, MAX_TIME_TO_COLLISION
        if self.tracker is not None:
            self.tracker.reset()
            self._track(self.tracker, reading.ranges, ORIGIN)

    def track_people(self) -> None:
        self.tracker = PeopleTracker(self.params.lidar, self.control_period)
        if isinstance(self.estimator, KeyScanSlam):
            self.estimator.meets_people = True

    def _track(self, tracker: PeopleTracker, ranges: np.ndarray, motion: Pose2D) -> None:
        self.belief.people = tracker.update(ranges, motion)
        self.belief.on_people = tracker.is_on_person(ranges, standing=False)

    def locate(self, flags: int) -> None:
        """Update estimated pose, map and path after a control period, from the scan or from odometry.

        `flags`: `SCAN` to process the scan, `REMEMBER` to record the position. Raises ValueError if the estimator
        returns invalid results.
        """
        if self.tracker is not None:
            self._track(self.tracker, self.ranges, Pose2D(*self._row["odometry"].tolist()))
        if flags & SCAN:
            self.integrate()
            return
        belief = self.estimator.belief
        belief.pose, belief.update = self.predicted_pose, NO_UPDATE
        if flags & REMEMBER:
            self._remember(belief.pose)

    def integrate(self) -> None:
        """Process the last scan: update pose, map and path."""
        estimator: Any = self.estimator
        if estimator.follows_odometry and estimator.last_key_pose is not None:
            predicted, estimator.slip = self.predicted_pose, float(self._row["slip"])
            self.follow(estimator.process_key_scan(self._filtered(self.ranges), predicted))
            return
        reading = self.reading
        if self.peers or self.tracker is not None:
            reading = reading._replace(ranges=self._filtered(reading.ranges))
        self.follow(estimator.update(reading, self.motion))

    def _filtered(self, ranges: np.ndarray) -> np.ndarray:
        if self.tracker is not None:
            if isinstance(self.estimator, KeyScanSlam):
                self.estimator.unmatched = self.tracker.is_on_person(ranges, standing=True)
            ranges = np.where(np.asarray(self.belief.on_people), np.float32(np.nan), ranges)
        if not self.peers:
            return ranges
        bodies = as_bodies(self.predicted_pose, [peer.predicted_pose for peer in self.peers], self.params.radius)
        is_on_peer = are_on_bodies(scan_ends(ranges, self._geometry), bodies, BODY_MARGIN)
        return np.where(is_on_peer, np.float32(np.nan), ranges)

    def follow(self, belief: Belief) -> None:
        """Store the estimator's result for a scan: pose, velocity, path and map changes."""
        if self._own_estimator:
            check_belief(belief, self._own_estimator, self.pyramid.grid, self._data)
            self._data = belief.grid.data, belief.grid.data.shape
        key_pose = self.estimator.last_key_pose if self.estimator.follows_odometry else belief.pose
        self._row["pose"], self._row["key_pose"] = belief.pose, key_pose
        self._row["slip"] = 0.0
        if belief.twist is not None:
            self._row["twist"] = belief.twist
        if belief.update.redrawn and belief.path is not None:
            self.trail.replace(interpolate(belief.path[:, :2]))
            self._row["trail"] = self.trail.last
        self.pyramid.update(belief.update)
        self._remember(belief.pose)

    def _remember(self, pose: Pose2D) -> None:
        if self.trail.append(pose):
            self.pyramid.mark(pose.x, pose.y)
            self._row["trail"] = self.trail.last


class GroundTruth:
    """True state and path of a robot, for rewards, metrics and rendering; never for policies."""

    def __init__(self, rows: Rows, index: int) -> None:
        self._rows, self._index = rows, index
        self.trail = Trail()
        """Path of true positions, world frame [m]."""
        self.remember()

    @property
    def state(self) -> RobotState:
        """True pose and velocity, world frame."""
        return self._rows.state(self._index)

    @property
    def path_length(self) -> float:
        return float(self._rows.numbers["path_length"][self._index])

    def remember(self) -> None:
        """Append the true position to the path if far enough from the last path point."""
        if self.trail.append(self.state.pose):
            self._rows.numbers["true_trail"][self._index] = self.trail.last


def start_tracking(robots: Sequence[Robot], has_people: bool, track_people: bool | None) -> None:
    """Let robots track people; None: those with a map, if the simulation has people."""
    for robot in robots:
        if track_people or (track_people is None and has_people and not isinstance(robot.estimator, DeadReckoning)):
            robot.track_people()


def reset_robots(
    robots: Sequence[Robot],
    rows: Rows,
    readings: Sequence[Reading],
    priors: Sequence[Prior],
    rngs: Sequence[np.random.Generator],
) -> None:
    """Start an episode of one robot, or of a team with a shared map."""
    shared_map = None
    for k, robot in enumerate(robots):
        robot.peers = [*robots[:k], *robots[k + 1 :]]
    for k, (robot, reading, prior, rng) in enumerate(zip(robots, readings, priors, rngs, strict=True)):
        robot.reset(rows, k, reading, prior, rng, shared_map)
        shared_map = robot.estimator.map
    if len(robots) > 1:
        pyramid = MapPyramid(robots[0].belief.grid, [robot.trail for robot in robots])
        for robot in robots:
            robot.pyramid = pyramid
    for robot in robots:
        if robot.estimator.uses_first_scan:
            robot.integrate()
        else:
            robot._remember(robot.belief.pose)
