"""Simple policies: random motion, wall following, route following."""

import math
from itertools import product

import numpy as np

from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.navigation import Candidates, FollowerParams, Navigator, PathFollower, free_distance
from lidarnaut.envs.navigation.policy import Explorer
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist
from lidarnaut.envs.tasks.route import SPACING, Progress, Route

from .route_plan import LIMIT_SHARE, RoutePlan, yaw_rate_for

CURVATURES = (-4.0, -2.0, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Curvatures of the arcs tried by the wall follower, right to left [1/m]. Scaled down for robot radii above 0.1 m."""
REFERENCE_RADIUS = 0.1
WALL_MARGIN = 0.12
"""Preferred gap between footprint and wall [m]."""
MIN_WALL_MARGIN = 0.02
"""Minimum gap between footprint and wall, in narrow passages [m]."""
ARC_LENGTH = 0.8
"""Length of the arcs that the wall follower checks for obstacles, from the robot's edge [m]."""
SPEED = 0.8
"""Speed of the wall follower, as a fraction of the maximum speed."""
TURN_RATE = 1.0
"""Maximum yaw rate of the wall follower [rad/s]."""
LOOKAHEAD_TIME = 0.75
"""Lookahead distance of the route follower divided by its speed [s]."""
MIN_TURN_TIME = 1.0
"""Minimum curve radius of the route follower divided by speed [s]: the robot slows down in sharp curves."""
ROTATE_FROM = 1.6
"""Heading error above which the route follower turns in place [rad]."""
LAG_TIME = 1.0
"""Time over which a lag behind the plan decays [s]."""
MAX_OFFSET, MAX_TURN = 0.3, 0.3
"""Offset [m] and heading error [rad] above which the robot returns to the route by pure pursuit."""


class RandomExplorer(Explorer):
    """Samples forward speed and yaw rate uniformly within the robot's limits."""

    def act(self, reading: Reading, belief: Belief) -> Twist:
        v, w = self.rng.uniform(-1.0, 1.0, 2).tolist()
        return Twist(v * self.robot.max_v, w * self.robot.max_w)


class RandomChooser(RuleExplorer):
    """Drives to a random reachable frontier."""

    def __init__(self) -> None:
        super().__init__(self._draw)

    def _draw(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        return np.arange(len(candidates)) == self.rng.integers(len(candidates))


class WallFollower(Explorer):
    """Follows walls on the robot's right side, by the lidar scan alone.

    The robot drives the rightmost collision-free arc. After a full turn, the robot rotates by a random angle and drives
    straight to another wall.
    """

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._period, self._rng = robot, control_period, rng
        self._curvatures = (np.array(CURVATURES) * REFERENCE_RADIUS / max(robot.radius, REFERENCE_RADIUS)).tolist()
        self._reach = robot.radius + ARC_LENGTH
        self._navigator = Navigator(robot, control_period)
        self._is_following = False
        self._turned = 0.0

    def act(self, reading: Reading, belief: Belief) -> Twist:
        navigator = self._navigator
        navigator.sense(reading)
        if reading.bumper and not navigator.is_recovering:
            navigator.recover()
        self._turned += navigator.velocity.w * self._period
        twist = navigator.command(ORIGIN) if navigator.is_recovering else self._command(navigator.obstacles)
        navigator.note_command(twist)
        return twist

    def _command(self, obstacles: np.ndarray) -> Twist:
        turn = Twist(0.0, min(TURN_RATE, self._robot.max_w))
        if self._is_following and abs(self._turned) > 2.0 * math.pi:
            # A fixed angle could lead around the same wall again.
            self._is_following = False
            self._navigator.spin(self._rng.uniform(0.4, 1.8))
            return turn
        if not self._is_following:
            if self._is_free(obstacles, 0.0, WALL_MARGIN):
                return self._drive(0.0)
            self._is_following, self._turned = True, 0.0
        arcs = product((WALL_MARGIN, MIN_WALL_MARGIN), self._curvatures)
        return next((self._drive(arc) for margin, arc in arcs if self._is_free(obstacles, arc, margin)), turn)

    def _is_free(self, obstacles: np.ndarray, curvature: float, margin: float) -> bool:
        return free_distance(obstacles, curvature, self._robot.radius + margin, self._reach) >= self._reach

    def _drive(self, curvature: float) -> Twist:
        robot = self._robot
        v = min(SPEED * robot.max_v, math.sqrt(robot.max_acc_v * self._reach))
        limit = min(TURN_RATE, robot.max_w)
        if abs(curvature) * v > limit:
            v = limit / abs(curvature)
        return Twist(v, curvature * v)


class RouteFollower(Explorer):
    """Follows a given route by the plan; near obstacles and away from the route by regulated pure pursuit."""

    along: float
    """Arc length of the planned position at the end of the control period [m]."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._navigator = Navigator(robot, control_period)
        params = FollowerParams(lookahead_time=LOOKAHEAD_TIME, min_turn_time=MIN_TURN_TIME, rotate_from=ROTATE_FROM)
        self._follower = PathFollower(robot, control_period, params)

    def set_route(self, route: Route) -> None:
        self._follower.set_path(route.points)
        self._plan = RoutePlan(route, self.robot)
        self._progress = Progress(self._plan.path)
        self.along, self._planned = 0.0, Twist(0.0, 0.0)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        navigator = self._navigator
        navigator.sense(reading)
        pursuit = self._follower.command(belief.pose, navigator.velocity, navigator.obstacles)
        robot, period, before, offset = self.robot, self.control_period, self._planned, self._locate(belief.pose)
        most_v, most_w = robot.max_acc_v * period, robot.max_acc_w * period
        self.along = min(max(self.along, offset.x - SPACING), offset.x + SPACING)
        v = min(before.v + LIMIT_SHARE * most_v, self._plan.speed(self.along + before.v * period), pursuit.v)
        step = 0.5 * (before.v + v) * period
        w = yaw_rate_for(self._plan.turn(offset, step), before.w, robot.max_acc_w, period)
        w = min(max(w, -robot.max_w), robot.max_w)
        look = max(ARC_LENGTH, v**2 / robot.max_acc_v)  # twice the braking distance
        arc = w / max(v, 1e-6), robot.radius + MIN_WALL_MARGIN, look
        is_free = free_distance(navigator.obstacles, *arc) >= look
        if not is_free or pursuit.v <= 0.0 or abs(offset.y) > MAX_OFFSET or abs(offset.theta) > MAX_TURN:
            self.along, (v, w) = offset.x, pursuit
        command = Twist(min(max(v + (self.along - offset.x) / LAG_TIME, 0.0), robot.max_v), w)
        v = min(max(v, before.v - most_v), before.v + most_v)
        self._planned = Twist(v, min(max(w, before.w - most_w), before.w + most_w))
        self.along += 0.5 * (before.v + v) * period
        return command

    def _locate(self, pose: Pose2D) -> Pose2D:
        self._progress.update(pose)
        path, k = self._progress.route, self._progress.index
        (x, y), heading = path.points[k].tolist(), float(path.headings[k])
        along = float(path.along[k]) + Pose2D(x, y, heading).between(pose).x
        _, left, turn = path.at(along).between(pose)
        return Pose2D(along, left, turn)
