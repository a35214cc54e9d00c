"""Local planner after Nav2's DWB (dynamic window approach), with the critics of Nav2's bring-up file.

Goal critics aim at the farthest path point that a trajectory can reach. In Nav2, they aim at the edge of the local
costmap, which draws robots off a path that turns back.
"""

import math

import numpy as np

from lidarnaut.envs.geometry import OCCUPIED, Pose2D, wrap_angle
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.geometry.lines import lengths_along
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist

from .costmap import CostmapParams, inflate
from .critics import FRONT_DISTANCE, NUM_CRITICS, Ending, Rasters, RolloutParams, cell_of, judge, spread
from .obstacles import without_people
from .regulated_pursuit import NEAREST_WINDOW, nearest_index

# Values of Nav2's bring-up file.
MAX_W = 1.0
"""Maximum yaw rate [rad/s], limited by the robot."""
NUM_V, NUM_W = 20, 20
"""Numbers of sampled forward speeds and yaw rates."""
SIM_TIME = 1.7
"""Duration of a simulated trajectory [s]."""
LINEAR_GRANULARITY, ANGULAR_GRANULARITY = 0.05, 0.025
"""Maximum step [m] and turn [rad] between poses of a trajectory."""
GOAL_TOLERANCE = 0.25
"""Distance to the goal that starts the final turn [m]."""
RESET_DISTANCE, RESET_ANGLE = 0.05, 0.2
"""Distance [m] or angle [rad] from the last reversal after which the robot may reverse again."""
ROTATE_TO_GOAL_SCALE, OSCILLATION_SCALE, BASE_OBSTACLE_SCALE = 32.0, 1.0, 0.02
GOAL_ALIGN_SCALE, PATH_ALIGN_SCALE, PATH_DIST_SCALE, GOAL_DIST_SCALE = 24.0, 32.0, 32.0, 24.0
RESOLUTION = 0.05
"""Cell side of the local costmap [m]."""
SIZE = 3.0
"""Minimum side of the local costmap [m]."""
INFLATION = 0.48
"""Width of the zone with increased costs around the footprint [m]."""


class DwbPlanner:
    """Local planner that samples velocity commands and scores their trajectories."""

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        self._robot = robot
        self._max_w = min(MAX_W, robot.max_w)
        self._horizon = robot.max_v * SIM_TIME + FRONT_DISTANCE
        half = math.ceil(max(0.5 * SIZE, self._horizon + robot.radius) / RESOLUTION)
        self._side = 2 * half + 1
        # Obstacles may lie anywhere in their cells.
        costmap = CostmapParams(robot.radius + 0.5 * RESOLUTION, robot.radius + INFLATION)
        self._reach, self._table = costmap.reach(RESOLUTION), costmap.table(RESOLUTION)
        # As in Nav2, a step costs half a cell's side.
        steps = np.array([GOAL_ALIGN_SCALE, PATH_ALIGN_SCALE, PATH_DIST_SCALE, GOAL_DIST_SCALE]) * 0.5 * RESOLUTION
        self._scales = np.array([ROTATE_TO_GOAL_SCALE, OSCILLATION_SCALE, BASE_OBSTACLE_SCALE, *steps])
        self._rasters = np.empty((3, self._side, self._side), dtype=np.int32)
        # Signs of the last nonzero speeds, and banned signs, 0 for none.
        self._signs, self._banned = np.zeros(2), np.zeros(2)
        self._turned_at: Pose2D | None = None
        self._path = np.empty((0, 2))
        self._index = 0
        self._heading: float | None = None
        self._has_no_path = False
        self.tracks = np.empty((0, 5))
        self.blocked = False

    @property
    def remaining(self) -> np.ndarray:
        return self._path[self._index :]

    def set_path(self, path: np.ndarray, heading: float | None = None) -> None:
        """Set the path, shape (n, 2), map frame [m], and the goal heading [rad], None for any."""
        self._path = path
        self._index = 0
        self._heading = heading

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        self._index = nearest_index(self._path, pose.x, pose.y, self._index, NEAREST_WINDOW)
        costs, squared = self._look(without_people(obstacles, self.tracks))
        to_goal = self._measure(pose, costs)
        self._allow_turning_back(pose)
        limits = self._robot.max_acc_v, self._robot.max_acc_w
        rollout = RolloutParams(*twist, *limits, SIM_TIME, LINEAR_GRANULARITY, ANGULAR_GRANULARITY)
        is_near = self._heading is not None and to_goal <= GOAL_TOLERANCE
        heading = wrap_angle(self._heading - pose.theta) if self._heading is not None else 0.0
        ending = Ending(is_near, heading, to_goal > FRONT_DISTANCE)
        twists = self._samples(twist)
        scores = np.empty((len(twists), NUM_CRITICS))
        bans = tuple(banned == sign for banned in self._banned.tolist() for sign in (-1.0, 1.0))
        rasters = Rasters(costs, squared, self._rasters, RESOLUTION)
        judge(twists, bans, rollout, ending, rasters, self.tracks, self._robot.radius, scores)
        totals = scores @ self._scales
        self.blocked = bool(np.isnan(totals).all())
        if self.blocked:
            return Twist(0.0, 0.0)
        v, w = (float(k) for k in twists[np.nanargmin(totals)])
        self._take_note(pose, v, w)
        self.blocked = v == 0.0 and self._has_no_path
        return Twist(v, w)

    def _samples(self, twist: Twist) -> np.ndarray:
        robot = self._robot
        reach_v, reach_w = robot.max_acc_v * SIM_TIME, robot.max_acc_w * SIM_TIME
        lows = max(0.0, min(twist.v - reach_v, robot.max_v)), max(-self._max_w, twist.w - reach_w)
        highs = min(robot.max_v, max(twist.v + reach_v, 0.0)), min(self._max_w, twist.w + reach_w)
        speeds = np.unique(np.append(np.linspace(lows[0], highs[0], NUM_V), 0.0))
        rates = np.unique(np.append(np.linspace(lows[1], highs[1], NUM_W), 0.0))
        return np.stack(np.meshgrid(speeds, rates, indexing="ij"), axis=-1).reshape(-1, 2)

    def _look(self, obstacles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data = np.zeros((self._side, self._side), dtype=np.int8)
        cells = np.floor(obstacles / RESOLUTION + 0.5 * self._side).astype(np.int64)
        cells = cells[((cells >= 0) & (cells < self._side)).all(axis=1)]
        data[cells[:, 1], cells[:, 0]] = OCCUPIED
        return inflate(data, self._reach, self._table), squared_distances(data > 0, self._reach)

    def _measure(self, pose: Pose2D, costs: np.ndarray) -> float:
        side = self._side
        points = pose.inverse().transform(self.remaining)
        cells = np.floor(points / RESOLUTION + 0.5 * side).astype(np.int64)
        along = lengths_along(points)
        inside = ((cells >= 0) & (cells < side)).all(axis=1)
        if not inside.all():
            cells = cells[: int(np.argmin(inside))]
        flat = cells[:, 1] * side + cells[:, 0]
        to_path, to_goal, to_goal_ahead = self._rasters
        spread(costs, to_path, np.unique(flat))
        spread(costs, to_goal, np.array([side * side // 2]))
        ends = np.flatnonzero(to_goal.ravel()[flat] < side * side)
        # Aim beyond reach only if an obstacle covers the path: the robot would leave a path that turns back.
        beyond = ends[along[ends] >= self._horizon][:1]
        end = int(beyond[0]) if len(beyond) else int(ends[-1]) if len(ends) else 0
        self._has_no_path = end < len(points) - 1 and along[end] < GOAL_TOLERANCE
        spread(costs, to_goal, flat[end : end + 1] if len(ends) else flat[:0])
        x, y = points[end]
        bearing = math.atan2(y, x)
        cell = cell_of(x + FRONT_DISTANCE * math.cos(bearing), y + FRONT_DISTANCE * math.sin(bearing), side, RESOLUTION)
        spread(costs, to_goal_ahead, np.array([cell])[: cell >= 0])
        return float(np.hypot(*points[-1]))

    def _allow_turning_back(self, pose: Pose2D) -> None:
        if self._turned_at is None:
            return
        away = self._turned_at.between(pose)
        if math.hypot(away.x, away.y) > RESET_DISTANCE or abs(away.theta) > RESET_ANGLE:
            self._turned_at = None
            self._signs, self._banned = np.zeros(2), np.zeros(2)

    def _take_note(self, pose: Pose2D, v: float, w: float) -> None:
        signs = np.sign([v, w if abs(v) <= RESET_DISTANCE else 0.0])
        turned = signs * self._signs < 0.0
        self._banned = np.where(turned, -signs, self._banned)
        self._signs = np.where(signs == 0.0, self._signs, signs)
        if turned.any():
            self._turned_at = pose
