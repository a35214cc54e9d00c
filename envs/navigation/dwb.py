"""A local planner in the manner of Nav2's DWB: try twists, judge where they lead, take the best.

The trajectories are those of `dwb_plugins::StandardTrajectoryGenerator`, the critics those of Nav2's bring-up file. The
local costmap is a square that moves and turns with the robot, made of the obstacles around it. One thing differs: Nav2
makes for the point where the path leaves the local costmap, which draws robots off a path that comes back; here they
make for the point of the path that a trajectory reaches.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from envs.geometry import OCCUPIED, Pose2D, wrap_angle
from envs.geometry.distance_transform import squared_distances
from envs.geometry.polyline import lengths_along
from envs.robots import RobotParams
from envs.simulation import Twist

from .costmap import CostmapParams, inflate
from .critics import NUM_CRITICS, Ending, Motion, Rasters, cell_of, judge, spread


@dataclass(frozen=True, slots=True)
class DwbParams:
    """How twists are tried and judged. Defaults: Nav2's bring-up file; speeds and accelerations are the robot's."""

    max_w: float = 1.0
    """Greatest yaw rate [rad/s], where the robot has it."""
    num_v: int = 20
    """Forward speeds that are tried."""
    num_w: int = 20
    """Yaw rates that are tried."""
    sim_time: float = 1.7
    """How far ahead trajectories are rolled out [s]."""
    linear_granularity: float = 0.05
    """Longest step of a trajectory [m]."""
    angular_granularity: float = 0.025
    """Greatest turn in a step [rad]."""
    goal_tolerance: float = 0.25
    """Distance from the goal at which the robot stops to turn [m]."""
    stopped_speed: float = 0.25
    """Speed up to which it counts as stopped there [m/s]."""
    slowing_factor: float = 5.0
    """Price of speed there."""
    forward_point_distance: float = 0.1
    """Distance of the point in front of the robot that alignment looks at [m]."""
    reset_distance: float = 0.05
    """Distance after which the robot may turn back to where it came from [m]."""
    reset_angle: float = 0.2
    """The same for turning on the spot [rad]."""
    rotate_to_goal: float = 32.0
    """Scale of the critic."""
    base_obstacle: float = 0.02
    """Scale of the critic."""
    goal_align: float = 24.0
    """Scale of the critic."""
    path_align: float = 32.0
    """Scale of the critic."""
    path_dist: float = 32.0
    """Scale of the critic."""
    goal_dist: float = 24.0
    """Scale of the critic."""
    resolution: float = 0.05
    """Side of a cell of the local costmap [m]."""
    size: float = 3.0
    """Least side of the local costmap [m]; it is made large enough for a trajectory at full speed."""
    inflation: float = 0.48
    """How far beyond the robot nearness to obstacles costs [m] (0.7 m from the centre of a TurtleBot3)."""
    cost_scaling_factor: float = 3.0
    """Rate at which that cost decays with the distance [1/m]."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{field.name} must be finite and not negative, got {value}")
        for name in ("max_w", "num_v", "num_w", "sim_time", "linear_granularity", "angular_granularity", "resolution"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


class Oscillation:
    """Forbids to turn back before the robot has got anywhere; one for each of forward speed and yaw rate."""

    def __init__(self) -> None:
        self._sign = 0.0
        self.banned = 0.0
        """Sign of the commands that are forbidden now, 0 for none."""

    def release(self) -> None:
        """Allow everything again."""
        self._sign = self.banned = 0.0

    def take(self, command: float) -> bool:
        """Take in a command; tells whether it turned back, so that its opposite is forbidden from now on."""
        sign = math.copysign(1.0, command) if command != 0.0 else 0.0
        turned = sign * self._sign < 0.0
        if turned:
            self.banned = -sign
        self._sign = sign or self._sign
        return turned


class DwbPlanner:
    """Drives along one path at a time; a `LocalPlanner`."""

    def __init__(self, robot: RobotParams, control_period: float, params: DwbParams = DwbParams()) -> None:
        """Prepare for a robot.

        Args:
            robot: limits and footprint.
            control_period: time between two calls of `command` [s].
            params: how to try and judge.
        """
        self._robot = robot
        self._params = params
        self._max_w = min(params.max_w, robot.max_w)
        self._horizon = robot.max_v * params.sim_time + params.forward_point_distance
        half = math.ceil(max(0.5 * params.size, self._horizon + robot.radius) / params.resolution)
        self._side = 2 * half + 1
        costmap = CostmapParams(robot.radius, robot.radius + params.inflation, params.cost_scaling_factor)
        self._reach, self._table = costmap.reach(params.resolution), costmap.table(params.resolution)
        # Scores of rasters count cells; half a cell's side per step, as Nav2 has it.
        per_step = 0.5 * params.resolution
        steps = params.goal_align, params.path_align, params.path_dist, params.goal_dist
        self._scales = np.array([params.rotate_to_goal, 1.0, params.base_obstacle, *(per_step * k for k in steps)])
        self._rasters = np.empty((3, self._side, self._side), dtype=np.int32)
        self._queue = np.empty(self._side**2, dtype=np.int32)
        self._oscillation = Oscillation(), Oscillation()
        self._turned_at: Pose2D | None = None
        self._path = np.empty((0, 2))
        self._index = 0
        self._heading: float | None = None
        self._has_no_path = False
        self.blocked = False
        """Whether the last command did not drive on because of obstacles."""
        self.scores = np.empty((0, NUM_CRITICS))
        """Scores of the twists that the last command was chosen from, by critic, without the scales."""

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""
        return self._path[self._index :]

    def set_path(self, path: np.ndarray, heading: float | None = None) -> None:
        """Follow another path from now on; see `LocalPlanner`."""
        self._path = path
        self._index = 0
        self._heading = heading

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the twist to command for the next period; see `LocalPlanner`."""
        params = self._params
        window = self._path[self._index : self._index + 40]
        self._index += int(np.argmin(((window - pose[:2]) ** 2).sum(axis=1)))
        costs, squared = self._look(obstacles)
        to_goal = self._measure(pose, costs)
        self._allow_turning_back(pose)
        motion = Motion(
            *twist,
            self._robot.max_acc_v,
            self._robot.max_acc_w,
            params.sim_time,
            params.linear_granularity,
            params.angular_granularity,
        )
        is_near = self._heading is not None and to_goal <= params.goal_tolerance
        heading = wrap_angle(self._heading - pose.theta) if self._heading is not None else 0.0
        ahead = params.forward_point_distance
        ending = Ending(is_near, heading, params.stopped_speed, params.slowing_factor, ahead, to_goal > ahead)
        twists = self._samples(twist)
        self.scores = np.empty((len(twists), NUM_CRITICS))
        bans = tuple(trend.banned == sign for trend in self._oscillation for sign in (-1.0, 1.0))
        judge(twists, bans, motion, ending, Rasters(costs, squared, self._rasters, params.resolution), self.scores)
        totals = self.scores @ self._scales
        self.blocked = bool(np.isnan(totals).all())
        if self.blocked:
            return Twist(0.0, 0.0)
        v, w = (float(k) for k in twists[np.nanargmin(totals)])
        self._take_note(pose, v, w)
        self.blocked = v == 0.0 and self._has_no_path
        return Twist(v, w)

    def _samples(self, twist: Twist) -> np.ndarray:
        """Return the twists that the robot can get to: shape (n, 2), float64 [m/s, rad/s]."""
        params, robot = self._params, self._robot
        reach_v, reach_w = robot.max_acc_v * params.sim_time, robot.max_acc_w * params.sim_time
        lows = max(0.0, min(twist.v - reach_v, robot.max_v)), max(-self._max_w, twist.w - reach_w)
        highs = min(robot.max_v, max(twist.v + reach_v, 0.0)), min(self._max_w, twist.w + reach_w)
        speeds = np.unique(np.append(np.linspace(lows[0], highs[0], params.num_v), 0.0))
        rates = np.unique(np.append(np.linspace(lows[1], highs[1], params.num_w), 0.0))
        return np.stack(np.meshgrid(speeds, rates, indexing="ij"), axis=-1).reshape(-1, 2)

    def _look(self, obstacles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return costs (uint8) and squared distances to the nearest obstacle (uint16 [cells2]) around the robot."""
        data = np.zeros((self._side, self._side), dtype=np.int8)
        cells = np.floor(obstacles / self._params.resolution + 0.5 * self._side).astype(np.int64)
        cells = cells[((cells >= 0) & (cells < self._side)).all(axis=1)]
        data[cells[:, 1], cells[:, 0]] = OCCUPIED
        return inflate(data, self._reach, self._table), squared_distances(data > 0, self._reach)

    def _measure(self, pose: Pose2D, costs: np.ndarray) -> float:
        """Fill the rasters of steps to the path, its end in reach, and beyond; return the distance to the goal [m]."""
        params, side = self._params, self._side
        points = pose.inverse().transform(self.remaining)
        cells = np.floor(points / params.resolution + 0.5 * side).astype(np.int64)
        along = lengths_along(points)
        inside = ((cells >= 0) & (cells < side)).all(axis=1)
        if not inside.all():
            cells = cells[: int(np.argmin(inside))]
        flat = cells[:, 1] * side + cells[:, 0]
        to_path, to_goal, to_goal_ahead = self._rasters
        self._spread(costs, to_path, np.unique(flat))
        self._spread(costs, to_goal, np.array([side * side // 2]))
        ends = np.flatnonzero(to_goal.ravel()[flat] < side * side)
        # What lies beyond a trajectory's reach would draw the robot off the path, to where the path comes back. Only
        # where an obstacle blocks the path, the robot makes for what lies behind it.
        beyond = ends[along[ends] >= self._horizon][:1]
        end = int(beyond[0]) if len(beyond) else int(ends[-1]) if len(ends) else 0
        self._has_no_path = end < len(points) - 1 and along[end] < params.goal_tolerance
        self._spread(costs, to_goal, flat[end : end + 1] if len(ends) else flat[:0])
        x, y = points[end]
        bearing = math.atan2(y, x)
        ahead = params.forward_point_distance
        cell = cell_of(x + ahead * math.cos(bearing), y + ahead * math.sin(bearing), side, params.resolution)
        self._spread(costs, to_goal_ahead, np.array([cell])[: cell >= 0])
        return float(np.hypot(*points[-1]))

    def _spread(self, costs: np.ndarray, raster: np.ndarray, seeds: np.ndarray) -> None:
        self._queue[: len(seeds)] = seeds
        spread(costs, raster, self._queue, len(seeds))

    def _allow_turning_back(self, pose: Pose2D) -> None:
        """Lift the bans once the robot has got away from where it last turned back."""
        if self._turned_at is None:
            return
        away = self._turned_at.between(pose)
        if math.hypot(away.x, away.y) > self._params.reset_distance or abs(away.theta) > self._params.reset_angle:
            self._turned_at = None
            for trend in self._oscillation:
                trend.release()

    def _take_note(self, pose: Pose2D, v: float, w: float) -> None:
        """Notice when a command turns back; turns while driving are no oscillation."""
        trend_v, trend_w = self._oscillation
        turned = trend_v.take(v)
        if abs(v) <= self._params.reset_distance:
            turned = trend_w.take(w) or turned
        if turned:
            self._turned_at = pose
