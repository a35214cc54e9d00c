"""Local planner after Nav2's DWB (dynamic window approach), with the critics of Nav2's bring-up file.

Goal critics aim at the farthest path point that a trajectory can reach. In Nav2, they aim at the edge of the local
costmap, which draws robots off a path that turns back.
"""

import math
from dataclasses import asdict, replace

import numpy as np

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lines import lengths_along
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist

from ..maps.costmap import CostmapParams
from ..maps.planning_params import DwbParams
from .critics import NUM_CRITICS, Ending, Rasters, cell_of, judge, spread
from .local_planner import LocalPlanner
from .regulated_pursuit import NEAREST_WINDOW, as_record, nearest_index


class DwbPlanner(LocalPlanner):
    """Local planner that samples velocity commands and scores their trajectories."""

    turns_at_goal = True

    def __init__(self, robot: RobotParams, control_period: float, params: DwbParams = DwbParams()) -> None:
        acc_v, acc_w = self._acc = params.acc_lim_x or robot.max_acc_v, params.acc_lim_theta or robot.max_acc_w
        inflation_radius = params.inflation_radius or robot.radius + 0.48
        self._params = params = replace(
            params,
            max_vel_x=min(params.max_vel_x, robot.max_v),
            max_vel_theta=min(params.max_vel_theta, robot.max_w),
            acc_lim_x=acc_v,
            acc_lim_theta=acc_w,
            inflation_radius=inflation_radius,
        )
        self._radius, self._numbers, resolution = robot.radius, as_record(asdict(params))[0], params.resolution
        self._horizon = params.max_vel_x * params.sim_time + params.forward_point_distance
        half = math.ceil(max(0.5 * params.width, self._horizon + robot.radius) / resolution)
        # Obstacles may lie anywhere in their cells.
        radius = robot.radius + 0.5 * resolution
        costmap = CostmapParams(radius, max(radius, inflation_radius), params.cost_scaling_factor)
        self._reach, self._table = costmap.reach(resolution), costmap.table(resolution)
        scales = params.goal_align_scale, params.path_align_scale, params.path_dist_scale, params.goal_dist_scale
        # As in Nav2, a step costs half a cell's side. `Oscillation` only rejects twists.
        steps = np.array(scales) * 0.5 * resolution
        self._scales = np.array([params.rotate_to_goal_scale, 1.0, params.base_obstacle_scale, *steps])
        self._side = 2 * half + 1
        self._rasters = np.empty((3, self._side, self._side), dtype=np.int32)
        # Signs of the last nonzero speeds, and banned signs, 0 for none.
        self._signs, self._banned = np.zeros(2), np.zeros(2)
        self._turned_at: Pose2D | None = None
        self._heading: float | None = None
        self._tolerance = params.xy_goal_tolerance
        self._has_no_path = False

    def set_path(self, path: np.ndarray, heading: float | None = None, tolerance: float = math.inf) -> None:
        """Set the path, shape (n, 2), map frame [m], and the goal heading [rad], None for any.

        `tolerance`: upper limit of `xy_goal_tolerance` for this goal [m].
        """
        super().set_path(path)
        self._heading, self._tolerance = heading, min(tolerance, self._params.xy_goal_tolerance)

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        params = self._params
        self._index = nearest_index(self._path, pose.x, pose.y, self._index, NEAREST_WINDOW)
        squared = self._squared_gaps(obstacles, self._side, params.resolution, self._reach)
        costs = self._table[np.minimum(squared, len(self._table) - 1)]
        to_goal = self._measure(pose, costs)
        self._allow_turning_back(pose)
        is_near = self._heading is not None and to_goal <= self._tolerance
        heading = wrap_angle(self._heading - pose.theta) if self._heading is not None else 0.0
        ending = Ending(is_near, heading, to_goal > params.forward_point_distance)
        twists = self._samples(twist)
        scores = np.empty((len(twists), NUM_CRITICS))
        bans = tuple(banned == sign for banned in self._banned.tolist() for sign in (-1.0, 1.0))
        rasters = Rasters(costs, squared, self._rasters)
        judge(twists, bans, tuple(twist), self._numbers, ending, rasters, self.tracks, self._radius, scores)
        totals = scores @ self._scales
        self.blocked = bool(np.isnan(totals).all())
        if self.blocked:
            return Twist(0.0, 0.0)
        v, w = (float(k) for k in twists[np.nanargmin(totals)])
        signs = np.sign([v, w if abs(v) <= params.x_only_threshold else 0.0])
        turned = signs * self._signs < 0.0
        self._banned = np.where(turned, -signs, self._banned)
        self._signs = np.where(signs == 0.0, self._signs, signs)
        if turned.any():
            self._turned_at = pose
        self.blocked = v == 0.0 and self._has_no_path
        return Twist(v, w)

    def _samples(self, twist: Twist) -> np.ndarray:
        params, (max_v, max_w) = self._params, (self._params.max_vel_x, self._params.max_vel_theta)
        reach_v, reach_w = np.multiply(self._acc, params.sim_time)
        lows = max(0.0, min(twist.v - reach_v, max_v)), max(-max_w, twist.w - reach_w)
        highs = min(max_v, max(twist.v + reach_v, 0.0)), min(max_w, twist.w + reach_w)
        speeds = np.unique(np.append(np.linspace(lows[0], highs[0], params.vx_samples), 0.0))
        rates = np.unique(np.append(np.linspace(lows[1], highs[1], params.vtheta_samples), 0.0))
        return np.stack(np.meshgrid(speeds, rates, indexing="ij"), axis=-1).reshape(-1, 2)

    def _measure(self, pose: Pose2D, costs: np.ndarray) -> float:
        side, resolution, ahead = self._side, self._params.resolution, self._params.forward_point_distance
        points = pose.inverse().transform(self.remaining)
        cells = np.floor(points / resolution + 0.5 * side).astype(np.int64)
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
        self._has_no_path = end < len(points) - 1 and along[end] < self._tolerance
        spread(costs, to_goal, flat[end : end + 1] if len(ends) else flat[:0])
        x, y = points[end]
        bearing = math.atan2(y, x)
        cell = cell_of(x + ahead * math.cos(bearing), y + ahead * math.sin(bearing), side, resolution)
        spread(costs, to_goal_ahead, np.array([cell])[: cell >= 0])
        return float(np.hypot(*points[-1]))

    def _allow_turning_back(self, pose: Pose2D) -> None:
        if self._turned_at is None:
            return
        away = self._turned_at.between(pose)
        params = self._params
        distance, angle = params.oscillation_reset_dist, params.oscillation_reset_angle
        if math.hypot(away.x, away.y) > distance or abs(away.theta) > angle:
            self._turned_at = None
            self._signs, self._banned = np.zeros(2), np.zeros(2)
