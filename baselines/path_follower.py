"""A path follower: pure pursuit, regulated by curvature, by obstacles and by the way that is left.

After Macenski, Singh, Martin, Gines: "Regulated Pure Pursuit for Robot Path Tracking" (2023), with Nav2's numbers where
they do not depend on the robot's speed. Two things differ. Obstacles come from the scan itself rather than from a
costmap, so that stops do not depend on where the robot believes to be. And where the arc to the carrot is blocked, the
carrot is pulled in before the robot slows down, so that lookahead does not cut corners.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from baselines.obstacles import free_distance
from envs.geometry import Pose2D, wrap_angle
from envs.robots import RobotParams
from envs.simulation import Twist

BEND_CHORD = 5
"""Points of the path between which its direction is measured."""


@dataclass(frozen=True, slots=True)
class FollowerParams:
    """How to follow a path. Speeds are fractions of the robot's limits where they must suit every robot."""

    lookahead_time: float = 1.5
    """Lookahead over speed [s]."""
    min_lookahead: float = 2.0
    """Least lookahead, in radii of the robot and at most 0.25 m."""
    max_lookahead: float = 0.9
    """Greatest lookahead [m]."""
    rotate_from: float = 0.785
    """Angle to the carrot from which the robot turns on the spot first [rad]."""
    rotate_until: float = 0.3
    """Angle at which it drives on [rad]."""
    max_rotation: float = 1.8
    """Greatest yaw rate [rad/s]; scan matching suffers from faster ones."""
    min_turn_time: float = 1.8
    """Arcs whose radius is driven through in less than this at full speed are driven more slowly [s]."""
    min_speed: float = 0.35
    """Least speed to which curvature and nearness slow the robot down, as a fraction of the limit."""
    nearness_time: float = 0.6
    """Obstacles nearer to the footprint than is driven in this time at full speed slow the robot down [s]."""
    margin: float = 0.4
    """Distance that is kept between footprint and obstacles, in radii of the robot and at most 0.03 m. From it 1.5
    standard deviations of the lidar's noise are taken: the nearest of a wall's many points lies that much too near."""
    sidesteps: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8)
    """Angles by which the robot steers past what stands between it and the carrot, on either side [rad]."""
    braking: float = 0.5
    """Share of the robot's greatest deceleration that braking counts on."""
    goal_tolerance: float = 0.15
    """Distance from a goal with a heading at which the robot stops to turn there [m]."""


@njit(cache=True, error_model="numpy")
def _nearest_index(path, x, y, first, window):
    """Return the index of the path's point nearest to (x, y), looking at `window` points from `first` on."""
    best, best_squared = first, np.inf
    for k in range(first, min(first + window, path.shape[0])):
        squared = (path[k, 0] - x) ** 2 + (path[k, 1] - y) ** 2
        if squared < best_squared:
            best, best_squared = k, squared
    return best


@njit(cache=True, error_model="numpy")
def _carrot_index(path, x, y, first, lookahead):
    """Return the index of the first point from `first` on at least `lookahead` [m] from (x, y), or of the last."""
    for k in range(first, path.shape[0]):
        if (path[k, 0] - x) ** 2 + (path[k, 1] - y) ** 2 >= lookahead * lookahead:
            return k
    return path.shape[0] - 1


@njit(cache=True, error_model="numpy")
def _distance_to_bend(path, first, chord, angle):
    """Return the length of the path from index `first` to where it bends by more than `angle` [rad], or to its end [m].

    Directions are those of chords of `chord` points, so that the staircase of a raster does not count as bends.
    """
    last = path.shape[0] - 1
    ahead = min(first + chord, last)
    direction = math.atan2(path[ahead, 1] - path[first, 1], path[ahead, 0] - path[first, 0])
    length = 0.0
    for k in range(first, last - chord):
        turn = math.atan2(path[k + chord, 1] - path[k, 1], path[k + chord, 0] - path[k, 0]) - direction
        if abs((turn + math.pi) % (2.0 * math.pi) - math.pi) > angle:
            break
        length += math.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
    return length


class PathFollower:
    """Drives along one path at a time; a `LocalPlanner`."""

    def __init__(self, robot: RobotParams, control_period: float, params: FollowerParams = FollowerParams()) -> None:
        """Prepare for a robot.

        Args:
            robot: limits and footprint.
            control_period: time between two calls of `command` [s].
            params: how to follow.
        """
        self._robot = robot
        self._period = control_period
        self._params = params
        self._min_lookahead = min(params.min_lookahead * robot.radius, 0.25)
        self._reach = robot.radius + min(params.margin * robot.radius, 0.03) - 1.5 * robot.lidar.noise_std
        self._side = 1.0
        self._path = np.empty((0, 2))
        self._index = 0
        self._heading: float | None = None
        self._rotating = False
        self.blocked = False
        """Whether the last command did not drive on because of obstacles."""

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""
        return self._path[self._index :]

    def set_path(self, path: np.ndarray, heading: float | None = None) -> None:
        """Follow another path from now on; see `LocalPlanner`."""
        self._path = path
        self._heading = heading
        self._index = 0

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the twist to command for the next period; see `LocalPlanner`."""
        params, robot = self._params, self._robot
        if self._heading is not None and math.hypot(*(self._path[-1] - pose[:2])) <= params.goal_tolerance:
            self.blocked = False
            return self.rotate(wrap_angle(self._heading - pose.theta))
        # A second of driving at full speed is as far as the nearest point can have moved on, with some to spare.
        self._index = _nearest_index(self._path, pose.x, pose.y, self._index, 40)
        self.blocked = False
        reach = params.lookahead_time * max(abs(twist.v), params.min_speed * robot.max_v)
        reach = min(max(reach, self._min_lookahead), params.max_lookahead)
        carrot, free = self._carrot(pose, reach, obstacles)
        angle = math.atan2(carrot[1], carrot[0])
        if abs(angle) > (params.rotate_until if self._rotating else params.rotate_from):
            self._rotating = True
            return self.rotate(angle)
        self._rotating = False
        distance = math.hypot(*carrot)
        if distance < 1e-3:
            return Twist(0.0, 0.0)
        curvature = 2.0 * carrot[1] / distance**2
        v = self._regulated_speed(curvature, free, obstacles)
        if v < 0.02 * robot.max_v:
            self.blocked = True
            return self.rotate(angle) if abs(angle) > 0.1 else Twist(0.0, 0.0)
        w = v * curvature
        limit = min(robot.max_w, params.max_rotation)
        if abs(w) > limit:
            v, w = v * limit / abs(w), math.copysign(limit, w)
        return Twist(v, w)

    def rotate(self, angle: float) -> Twist:
        """Return the twist that turns on the spot by `angle` [rad], slowing down in time to stop there."""
        robot, params = self._robot, self._params
        rate = min(math.sqrt(2.0 * params.braking * robot.max_acc_w * abs(angle)), 0.5 * abs(angle) / self._period)
        return Twist(0.0, math.copysign(min(rate, robot.max_w, params.max_rotation), angle))

    def _carrot(self, pose: Pose2D, lookahead: float, obstacles: np.ndarray) -> tuple[tuple[float, float], float]:
        """Return the point to steer for, base frame [m], and how far its arc is free [m]."""
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        while True:
            dx, dy = self._path[_carrot_index(self._path, pose.x, pose.y, self._index, lookahead)] - pose[:2]
            carrot = (c * dx + s * dy, c * dy - s * dx)
            free = self._free(carrot, lookahead, obstacles)
            if free >= lookahead:
                return carrot, free
            if lookahead <= self._min_lookahead:
                return self._sidestep(carrot, free, obstacles)
            lookahead = max(0.6 * lookahead, self._min_lookahead)

    def _sidestep(
        self, carrot: tuple[float, float], free: float, obstacles: np.ndarray
    ) -> tuple[tuple[float, float], float]:
        """Return a point beside the carrot whose arc is free, on the side taken last if possible; else the carrot."""
        for offset in self._params.sidesteps:
            for side in (self._side, -self._side):
                c, s = math.cos(side * offset), math.sin(side * offset)
                beside = (c * carrot[0] - s * carrot[1], s * carrot[0] + c * carrot[1])
                free_beside = self._free(beside, self._min_lookahead, obstacles)
                if free_beside >= self._min_lookahead:
                    self._side = side
                    return beside, free_beside
        return carrot, free

    def _free(self, carrot: tuple[float, float], lookahead: float, obstacles: np.ndarray) -> float:
        """Return how far the arc to a point (base frame [m]) is free, looking at least as far as braking takes [m]."""
        curvature = 2.0 * carrot[1] / max(carrot[0] ** 2 + carrot[1] ** 2, 1e-6)
        look = max(lookahead, self._braking_distance(self._robot.max_v) + 0.03)
        return free_distance(obstacles, curvature, self._reach, look)

    def _regulated_speed(self, curvature: float, free: float, obstacles: np.ndarray) -> float:
        """Return the forward speed [m/s] for an arc of which `free` metres are free."""
        params, robot = self._params, self._robot
        v = robot.max_v
        v *= min(1.0, max(1.0 / (max(abs(curvature), 1e-6) * robot.max_v * params.min_turn_time), params.min_speed))
        if len(obstacles):
            # Only what lies ahead slows down: x over minus half the footprint.
            ahead = obstacles[obstacles[:, 0] > 0.0]
            gap = float(np.sqrt((ahead**2).sum(axis=1).min())) - robot.radius if len(ahead) else math.inf
            v = min(v, robot.max_v * max(gap / (params.nearness_time * robot.max_v), params.min_speed))
        # Whoever turns on the spot at a bend, or stops at the end, must have braked before.
        bend = _distance_to_bend(self._path, self._index, BEND_CHORD, params.rotate_from)
        v = min(v, max(self._speed_for(bend), params.min_speed * robot.max_v))
        return min(v, self._speed_for(free))

    def _braking_distance(self, speed: float) -> float:
        """Return how far the robot gets from `speed` to a stop [m], one period of delay included."""
        return speed * self._period + 0.5 * speed**2 / (self._params.braking * self._robot.max_acc_v)

    def _speed_for(self, free: float) -> float:
        """Return the greatest speed from which the robot stops within `free` metres: the inverse of the above."""
        deceleration = self._params.braking * self._robot.max_acc_v
        delay = deceleration * self._period
        return math.sqrt(delay**2 + 2.0 * deceleration * max(free, 0.0)) - delay
