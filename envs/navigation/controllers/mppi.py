"""Model predictive path integral control (MPPI): average sampled twist sequences, weighted by cost.

After Williams et al., "Information theoretic MPC for model-based reinforcement learning" (ICRA 2017), algorithm 2, with
critics of Nav2's MPPI controller. Noise is drawn once, as in Nav2. Tracked people move with constant velocity.
"""

import math
from collections import namedtuple
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lines import lengths_along
from lidarnaut.envs.navigation.controllers.local_planner import LocalPlanner
from lidarnaut.envs.navigation.controllers.regulated_pursuit import NEAREST_WINDOW, nearest_index
from lidarnaut.envs.navigation.maps.obstacles import stoppable_share
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist

COLLISION_COST = 1e5
"""Cost of a collision: decreases linearly from 2e5 at the first step of a trajectory to 1e5 at its end."""
SPIN_STRIDE = 10
"""Every `SPIN_STRIDE`-th twist sequence turns on the spot, because noise rarely samples such turns."""
HEADING_OFFSET = 10
"""Number of path points from the nearest point to the point that the robot should face."""
HEADING_RADIUS = 0.2
"""The cost `angle` is zero below this distance to the path point that the robot should face [m]."""


@dataclass(frozen=True, slots=True)
class MppiParams:
    """Sampling and cost parameters, tuned for the world family `hall`."""

    num_samples: int = 800
    """Number of sampled twist sequences (Nav2: 2,000)."""
    num_steps: int = 20
    """Length of a twist sequence [control periods] (Nav2: 56 of 0.05 s)."""
    v_std: float = 0.5
    """Standard deviation of sampled forward speeds, as a fraction of the maximum speed (Nav2: 0.4)."""
    w_std: float = 0.4
    """Standard deviation of sampled yaw rates, as a fraction of the maximum yaw rate (Nav2: 0.2)."""
    correlation: float = 0.7
    """Correlation of noise between successive control periods (Nav2: white noise)."""
    temperature: float = 0.3
    """Cost increase that divides a sample's weight by e (lambda of Williams et al.)."""
    gamma: float = 0.015
    """Weight of the control cost for deviations from the previous mean sequence."""
    max_rotation: float = 4.0
    """Maximum yaw rate [rad/s], limited by the robot."""
    backwards: float = 0.0
    """Maximum backward speed, as a fraction of the maximum speed (Nav2: 0.7)."""
    follow: float = 10.0
    """Cost per second of the driving time left to the end of the path at full speed, mean over a sampled trajectory."""
    align: float = 2.0
    """Cost per metre of mean distance from the path."""
    angle: float = 1.0
    """Cost per radian between the final heading and the direction to the path ahead."""
    nearness: float = 2.0
    """Cost per second of touching an obstacle; decreases quadratically to zero at the gap `margin`."""
    margin: float = 0.25
    """Gap to obstacles above which the cost `nearness` is zero [m]."""
    people: float = 20.0
    """Cost per second of touching a person; decreases quadratically to zero at the gap `people_margin`."""
    people_margin: float = 0.8
    """Gap to people above which the cost `people` is zero [m]."""
    people_touched: float = 400.0
    """Cost of each control period in contact with a predicted person; decays with prediction time."""
    people_gap: float = 0.05
    """Gap to a person that counts as contact [m]."""
    headway: float = 0.05
    """Increase of the contact gap `people_gap` with the robot's speed [m per m/s], as people may swerve."""
    doubt_time: float = 3.0
    """Time constant of the decay of `people_touched` with prediction time [s]."""
    twirl: float = 0.1
    """Cost per rad/s of mean absolute yaw rate."""
    braking: float = 0.3
    """Fraction of maximum deceleration assumed in the final collision check."""
    reverse: float = 2.0
    """Cost per second of driving backwards at full speed."""
    resolution: float = 0.03
    """Cell side of the raster of obstacle distances [m]."""
    max_range: float = 4.0
    """Maximum half side of the raster of obstacle distances [m]."""


_OF_ROBOT = ("period", "radius", "max_v", "min_v", "max_w", "max_acc_v", "max_acc_w")
_OWN = tuple(field.name for field in fields(MppiParams))
MppiNumbers = namedtuple("MppiNumbers", [*_OF_ROBOT, *_OWN])  # type: ignore[misc]


def mppi_numbers(robot: RobotParams, period: float, params: MppiParams) -> Any:
    """Return robot limits and planner parameters for compiled functions; `period`: control period [s]."""
    limits = robot.max_v, -params.backwards * robot.max_v, min(params.max_rotation, robot.max_w)
    of_robot = period, robot.radius, *limits, robot.max_acc_v, robot.max_acc_w
    return MppiNumbers(*map(float, (*of_robot, *attrgetter(*_OWN)(params))))


@njit(cache=True, error_model="numpy")
def rate(controls, mean, now, path, along, squared, tracks, p, costs):
    """Compute the costs of twist sequences in the base frame.

    `controls`: sequences, shape (n, num_steps, 2) [m/s, rad/s]. `mean`: mean of the sampling distribution. `now`:
    current twist. `path`: shape (k, 2), k > 0 [m]. `along`: path length up to each point [m]. `squared`: squared
    obstacle distances [cells2], robot in the centre. `tracks`: see `PeopleTracker.people`. Writes `costs`, shape (n,).
    """
    side, last = squared.shape[0], path.shape[0] - 1
    half, dt = 0.5 * side, p.period
    here = math.sqrt(squared[side // 2, side // 2]) * p.resolution
    for i in range(controls.shape[0]):
        x = y = theta = cost = away = left = turned = 0.0
        v, w = now
        nearest, best = 0, math.hypot(path[0, 0], path[0, 1])
        for t in range(controls.shape[1]):
            v += min(max(controls[i, t, 0] - v, -p.max_acc_v * dt), p.max_acc_v * dt)
            w += min(max(controls[i, t, 1] - w, -p.max_acc_w * dt), p.max_acc_w * dt)
            x += v * dt * math.cos(theta + 0.5 * w * dt)
            y += v * dt * math.sin(theta + 0.5 * w * dt)
            theta += w * dt
            turned += abs(w)
            cost -= p.reverse * dt * min(v, 0.0) / p.max_v
            cost += p.gamma * (mean[t, 0] * (controls[i, t, 0] - mean[t, 0]) / (p.v_std * p.max_v) ** 2)
            cost += p.gamma * (mean[t, 1] * (controls[i, t, 1] - mean[t, 1]) / (p.w_std * p.max_w) ** 2)
            row, col = math.floor(y / p.resolution + half), math.floor(x / p.resolution + half)
            if 0 <= row < side and 0 <= col < side:
                distance = math.sqrt(squared[row, col]) * p.resolution
                if distance < p.radius + 0.5 * p.resolution and distance <= here:
                    cost += COLLISION_COST * (2.0 - t / controls.shape[1])
                    break
                cost += p.nearness * dt * max(0.0, 1.0 - max(distance - p.radius, 0.0) / p.margin) ** 2
            cost += _cost_of_people(x, y, abs(v), (t + 1) * dt, tracks, p)
            best = math.hypot(path[nearest, 0] - x, path[nearest, 1] - y)
            while nearest < last:
                following = math.hypot(path[nearest + 1, 0] - x, path[nearest + 1, 1] - y)
                if following > best:
                    break
                nearest, best = nearest + 1, following
            away += best
            left += along[last] - along[nearest] + best
        cost += p.follow * left / p.max_v / controls.shape[1]
        cost += (p.align * away + p.twirl * turned) / controls.shape[1]
        ahead = min(nearest + HEADING_OFFSET, last)
        dx, dy = path[ahead, 0] - x, path[ahead, 1] - y
        if math.hypot(dx, dy) > HEADING_RADIUS:
            cost += p.angle * abs(wrap_angle(math.atan2(dy, dx) - theta))
        costs[i] = cost


@njit(cache=True, error_model="numpy")
def _cost_of_people(x, y, v, time, tracks, p):
    cost = 0.0
    for k in range(tracks.shape[0]):
        away = math.hypot(tracks[k, 0] + time * tracks[k, 2] - x, tracks[k, 1] + time * tracks[k, 3] - y)
        gap = away - tracks[k, 4] - p.radius
        if gap < p.people_margin:
            share = 1.0 - max(gap, 0.0) / p.people_margin
            touched = p.people_touched * math.exp(-time / p.doubt_time) if gap < p.people_gap + p.headway * v else 0.0
            cost += touched + p.people * p.period * share * share
    return cost


class MppiPlanner(LocalPlanner):
    """Local planner that uses model predictive path integral control (MPPI)."""

    def __init__(
        self, robot: RobotParams, control_period: float, rng: np.random.Generator, params: MppiParams = MppiParams()
    ) -> None:
        self._numbers = mppi_numbers(robot, control_period, params)
        self._horizon = params.num_steps * control_period
        noise = rng.standard_normal((params.num_steps, params.num_samples, 2))
        for t in range(1, params.num_steps):
            noise[t] = params.correlation * noise[t - 1] + math.sqrt(1.0 - params.correlation**2) * noise[t]
        noise *= params.v_std * robot.max_v, params.w_std * self._numbers.max_w
        noise[:, 0] = 0.0  # previous mean without noise
        self._noise = np.ascontiguousarray(noise.transpose(1, 0, 2))
        self._mean = np.zeros((params.num_steps, 2))
        reach = min(robot.max_v * self._horizon + robot.radius, params.max_range)
        self._side = 2 * math.ceil(reach / params.resolution) + 1
        self._reach = min(math.ceil((robot.radius + params.margin) / params.resolution), 180)

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        p = self._numbers
        self._index = nearest_index(self._path, pose.x, pose.y, self._index, NEAREST_WINDOW)
        path = pose.inverse().transform(self.remaining)
        along = lengths_along(path)
        count = max(1, int(np.searchsorted(along, p.max_v * self._horizon + 0.5)))
        squared = self._squared_gaps(obstacles, self._side, p.resolution, self._reach)
        scene = path[:count], along[:count], squared, self.tracks, p
        self._mean = np.vstack([self._mean[1:], self._mean[-1:]])
        controls = self._mean + self._noise
        controls[1] = 0.0
        controls[2::SPIN_STRIDE, :, 0] = 0.0
        np.clip(controls, (p.min_v, -p.max_w), (p.max_v, p.max_w), out=controls)
        costs = np.empty(len(controls))
        rate(controls, self._mean, tuple(twist), *scene, costs)
        weights = np.exp((costs.min() - costs) / p.temperature)
        mean = np.tensordot(weights / weights.sum(), controls, axes=1)
        best = controls[int(costs.argmin())]
        # The mean of two paths around an obstacle may collide.
        rate(np.stack([mean, best]), self._mean, tuple(twist), *scene, costs)
        self._mean = mean if costs[0] < costs[1] + p.temperature else best
        if costs[:2].min() >= COLLISION_COST:
            self._mean = np.zeros_like(mean)
        v, w = self._mean[0].tolist()
        share = stoppable_share(obstacles, v, w, p.radius, p.braking * p.max_acc_v, p.period)
        v, w = share * v, share * w
        self.blocked = abs(v) < 0.05 * p.max_v and abs(w) < 0.1 and float(along[-1]) > p.radius
        return Twist(v, w)
