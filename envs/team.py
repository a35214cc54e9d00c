"""What robots that explore together need beyond what one of them does."""

import math
from itertools import product

import numpy as np
from numba import njit

from envs.coverage import ExplorableArea
from envs.estimation.motion import make_motion_source
from envs.geometry import Pose2D
from envs.geometry.clearance import clearance
from envs.geometry.lines import cell_along
from envs.geometry.pose import distance
from envs.observation import Trail
from envs.robots import RobotParams
from envs.simulation import Reading, RobotState, Twist
from envs.slam import GivenPoseSlam, TinySlam
from envs.worlds import World

START_DISTANCE = 2.0
"""Robots start this near to the first one, if there is room; otherwise up to eight times as far [m]."""
START_GAPS = (0.5, 0.25, 0.1, 0.01)
"""Least gaps between the footprints of two robots at the start [m]: each is tried where there is no room for the ones
before."""
MATE_MARGIN = 0.15
"""Beams that end this near to a mate's footprint are taken to have hit it [m]: both poses are off by centimetres."""
MATES_RANGE = 16.0
"""Distance along either axis at which an observed mate's position saturates [m]: half of what `map_far` shows."""


class Member:
    """One robot of a team: where it truly is, what it senses and believes, and what it has done."""

    def __init__(self, robot: RobotParams, slam: TinySlam | GivenPoseSlam, control_period: float) -> None:
        """Prepare a robot with a SLAM of its own, whose map may be shared; `control_period` is in seconds."""
        self.slam = slam
        self._odometry = make_motion_source(robot, control_period)

    def stand(self, reading: Reading, state: RobotState) -> None:
        """Begin an episode: nothing is driven yet."""
        self.reading, self.state = reading, state
        self.twist = Twist(0.0, 0.0)
        """Velocity by wheel odometry."""
        self.action = np.zeros(2, dtype=np.float32)
        """The last one."""
        self.trail, self.true_trail = Trail(), Trail()
        """Where the robot believes to have been, map frame; where it has been, world frame."""
        self.path_length = 0.0
        """Driven so far in truth [m]."""
        self.collisions = 0
        """Contacts so far."""
        self._odometry.reset(reading)
        self.true_trail.append(state.pose)

    def drive(self, action: np.ndarray, reading: Reading, state: RobotState, period: float) -> tuple[Pose2D, Pose2D]:
        """Take note of a control period.

        Args:
            action: shape (2,), float32: what was done.
            reading: what the sensors say at its end.
            state: the truth then.
            period: its length [s].

        Returns:
            The motion of the base by odometry, and in truth.
        """
        before, touched = self.state.pose, self.reading.bumper
        self.action, self.reading, self.state = action, reading, state
        self.true_trail.append(state.pose)
        self.path_length += distance(state.pose.x - before.x, state.pose.y - before.y)
        self.collisions += reading.bumper and not touched
        motion = self._odometry.update(reading)
        self.twist = Twist(motion.x / period, motion.theta / period)
        return motion, before.between(state.pose)


@njit(cache=True, error_model="numpy")
def without_mates(ranges, directions, mount_x, mount_y, x, y, theta, mates, reach):
    """Return a scan without the beams that end at a mate: NaN in their place.

    Args:
        ranges: shape (num_beams,), float32 [m].
        directions: shape (2, num_beams), float64, cosine and sine of the beams in the base frame.
        mount_x: position of the lidar in the base frame [m].
        mount_y: the same [m].
        x: believed position of the base, map frame [m].
        y: the same [m].
        theta: believed heading [rad].
        mates: shape (m, 2), float64, believed positions of the mates, map frame [m].
        reach: distance from a mate's position within which a beam that ends has hit it [m].

    Returns:
        Shape (num_beams,), float32 [m].
    """
    result = ranges.copy()
    c, s = math.cos(theta), math.sin(theta)
    for i in range(mates.shape[0]):
        dx, dy = mates[i, 0] - x, mates[i, 1] - y
        u, v = c * dx + s * dy - mount_x, c * dy - s * dx - mount_y
        for k in range(ranges.shape[0]):
            r = float(ranges[k])
            across, along = r * directions[0, k] - u, r * directions[1, k] - v
            # False for NaN and infinity.
            if across * across + along * along < reach * reach:
                result[k] = np.nan
    return result


class MateFilter:
    """Takes the mates out of a robot's scans, so that they do not become walls of the map."""

    def __init__(self, robot: RobotParams) -> None:
        """Prepare for robots of one kind."""
        self._lidar = robot.lidar
        self._directions = robot.lidar.directions
        self._reach = robot.radius + MATE_MARGIN

    def __call__(self, ranges: np.ndarray, pose: Pose2D, mates: list[Pose2D]) -> np.ndarray:
        """Return a scan with NaN for beams that end at a mate.

        Args:
            ranges: shape (num_beams,), float32 [m].
            pose: where the robot believes to be, map frame.
            mates: where the others believe to be.
        """
        if not mates:
            return ranges
        positions, mount = np.array([mate[:2] for mate in mates]), self._lidar.mount
        return without_mates(ranges, self._directions, mount.x, mount.y, *pose, positions, self._reach)

    def hits(self, ranges: np.ndarray, pose: Pose2D, mate: Pose2D) -> np.ndarray:
        """Return where the beams end that end at a mate: shape (k, 2), float64, base frame [m]; see `__call__`."""
        is_hit = np.isnan(self(ranges, pose, [mate])) & ~np.isnan(ranges)
        mount = self._lidar.mount
        points: np.ndarray = (mount.x, mount.y) + (ranges[is_hit] * self._directions[:, is_hit]).T
        return points


def observe_mates(pose: Pose2D, mates: list[Pose2D]) -> np.ndarray:
    """Return where the mates are, as seen from a robot.

    Args:
        pose: where the robot believes to be, map frame.
        mates: where the others believe to be.

    Returns:
        Shape (mates, 4), float32: forward and to the left over `MATES_RANGE`, cosine and sine of the heading.
    """
    rows = np.empty((len(mates), 4), dtype=np.float32)
    for row, mate in zip(rows, mates, strict=True):
        away = pose.between(mate)
        row[:] = away.x / MATES_RANGE, away.y / MATES_RANGE, math.cos(away.theta), math.sin(away.theta)
    return rows.clip(-1.0, 1.0)


def draw_starts(
    area: ExplorableArea, world: World, robot: RobotParams, first: Pose2D, num_robots: int, rng: np.random.Generator
) -> list[Pose2D]:
    """Draw where the robots start: near the first one, in sight of it, apart from each other.

    Where there is no room for that, they start further from the first one, then nearer to each other, then out of
    its sight.

    Args:
        area: where robots can stand.
        world: for what stands there at the start.
        robot: gives the footprint.
        first: pose of the first robot, world frame.
        num_robots: how many there are, with the first.
        rng: draws places and headings.

    Raises:
        ValueError: there is no room for all of them within eight times `START_DISTANCE`, however close they stand.
    """
    starts, circles = [first], world.circles_at(0.0)
    roomy = area.walls.centers(np.argwhere(area.roomy))
    away = np.hypot(*(roomy - first[:2]).T)
    for must_see, gap, factor in product((True, False), START_GAPS, (1.0, 2.0, 4.0, 8.0)):
        if len(starts) == num_robots:
            break
        for x, y in rng.permutation(roomy[away <= factor * START_DISTANCE]):
            if len(starts) == num_robots:
                break
            is_apart = all(math.hypot(x - pose.x, y - pose.y) >= 2.0 * robot.radius + gap for pose in starts)
            if not is_apart or clearance(x, y, world.segments, circles) <= robot.radius:
                continue
            if not must_see or _in_sight(area, first, x, y):
                starts.append(Pose2D(float(x), float(y), float(rng.uniform(-math.pi, math.pi))))
    if len(starts) < num_robots:
        raise ValueError(
            f"there is room for {len(starts)} robots {robot.name!r} around the start {tuple(first)} in world "
            f"{world.name!r}, not for num_robots = {num_robots}"
        )
    return starts


def _in_sight(area: ExplorableArea, pose: Pose2D, x: float, y: float) -> bool:
    """Tell whether the straight line from a pose to (x, y), world frame [m], crosses no wall."""
    walls = area.walls
    (row, col), (goal_row, goal_col) = walls.cells(np.array([pose[:2], (x, y)])).tolist()
    num_steps = max(abs(goal_row - row), abs(goal_col - col), 1)
    step = (goal_row - row) / num_steps, (goal_col - col) / num_steps
    return all(walls.data[cell_along(row, col, *step, k)] == 0 for k in range(num_steps + 1))
