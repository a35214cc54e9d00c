"""Policies that need no map: at random, along walls, and along a route."""

import math
from itertools import product

import numpy as np

from lidarnaut.baselines.frontier.explorer import RuleExplorer
from lidarnaut.envs.estimation import ORIGIN, Belief
from lidarnaut.envs.navigation import Candidates, FollowerParams, Navigator, PathFollower, free_distance
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist
from lidarnaut.envs.tasks.route import Route

CURVATURES = (-4.0, -2.0, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Curvatures that are tried, from right to left, for a robot of a tenth of a metre; larger ones curve less [1/m]."""
REFERENCE_RADIUS = 0.1
"""That robot's radius [m]."""
MARGIN = 0.12
"""Distance that is kept between footprint and wall, where there is so much [m]."""
TIGHT_MARGIN = 0.02
"""Distance that is kept otherwise [m]."""
REACH = 0.8
"""Length of an arc that must be collision-free [m], beyond the robot's radius."""
SPEED = 0.8
"""Share of the maximum speed."""
TURN_RATE = 1.0
"""Yaw rate of turns, where the robot can turn that fast [rad/s]."""
LOOKAHEAD_TIME = 0.75
"""Lookahead over speed [s]: half of the path follower's, because a route is smooth where a raster's path is not."""
MIN_TURN_TIME = 1.0
"""Arcs whose radius is driven through in less than this at full speed are driven more slowly [s]."""
ROTATE_FROM = 1.6
"""Angle from which the robot stops and turns on the spot [rad]: a rounded corner of 90 degrees is driven through."""


class RandomExplorer:
    """Draws forward speed and yaw rate uniformly within the robot's limits."""

    end_reason = plan = None
    """Never stops, never plans."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot = robot
        self._rng = rng

    def act(self, reading: Reading, belief: Belief) -> Twist:
        v, w = self._rng.uniform(-1.0, 1.0, 2).tolist()
        return Twist(v * self._robot.max_v, w * self._robot.max_w)


class RandomChooser(RuleExplorer):
    """Draws any candidate."""

    def __init__(self) -> None:
        super().__init__(self._draw)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._rng = rng

    def _draw(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        return np.arange(len(candidates)) == self._rng.integers(len(candidates))


class WallFollower:
    """Follows walls to its right by the scan alone, and leaves each after a net rotation of a full turn.

    Of all arcs it drives the one that curves most to the right and is collision-free, which follows walls, rounds
    corners and turns out of dead ends alike. A robot that only did that would circle one pillar, or one room, for ever:
    it drives straight on from there, until it meets another wall.
    """

    end_reason = plan = None
    """Never stops, since without a map it cannot know when; never plans."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._period, self._rng = robot, control_period, rng
        self._curvatures = (np.array(CURVATURES) * REFERENCE_RADIUS / max(robot.radius, REFERENCE_RADIUS)).tolist()
        self._reach = robot.radius + REACH
        self._navigator = Navigator(robot, control_period)
        self._has_begun = self._is_following = False
        self._turned = 0.0

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist from `reading` alone; see `Explorer`."""
        navigator = self._navigator
        (navigator.sense if self._has_begun else navigator.reset)(reading)
        self._has_begun = True
        if reading.bumper and not navigator.is_recovering:
            navigator.recover()
        self._turned += navigator.velocity.w * self._period
        twist = navigator.command(ORIGIN) if navigator.is_recovering else self._command(navigator.obstacles)
        navigator.note_command(twist)
        return twist

    def _command(self, obstacles: np.ndarray) -> Twist:
        """Return the twist along the wall, or straight on while there is none."""
        turn = Twist(0.0, min(TURN_RATE, self._robot.max_w))
        if self._is_following and abs(self._turned) > 2.0 * math.pi:
            # A random angle: the same one would lead around the same wall again.
            self._is_following = False
            self._navigator.spin(self._rng.uniform(0.4, 1.8))
            return turn
        if not self._is_following:
            if self._is_free(obstacles, 0.0, MARGIN):
                return self._drive(0.0)
            self._is_following, self._turned = True, 0.0
        arcs = product((MARGIN, TIGHT_MARGIN), self._curvatures)
        return next((self._drive(arc) for margin, arc in arcs if self._is_free(obstacles, arc, margin)), turn)

    def _is_free(self, obstacles: np.ndarray, curvature: float, margin: float) -> bool:
        """Tell whether the robot can drive along an arc of a curvature [1/m] with a margin to all obstacles [m]."""
        return free_distance(obstacles, curvature, self._robot.radius + margin, self._reach) >= self._reach

    def _drive(self, curvature: float) -> Twist:
        """Return the twist along a free arc of a curvature [1/m]."""
        robot = self._robot
        v = min(SPEED * robot.max_v, math.sqrt(robot.max_acc_v * self._reach))
        limit = min(TURN_RATE, robot.max_w)
        if abs(curvature) * v > limit:
            v = limit / abs(curvature)
        return Twist(v, curvature * v)


class RouteFollower:
    """Drives a route with the path follower, from the robot's readings and its estimated pose."""

    end_reason = plan = None
    """The task ends the episode, and draws the route."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._navigator = Navigator(robot, control_period)
        self._has_begun = False
        params = FollowerParams(lookahead_time=LOOKAHEAD_TIME, min_turn_time=MIN_TURN_TIME, rotate_from=ROTATE_FROM)
        self._follower = PathFollower(robot, control_period, params)

    def set_route(self, route: Route) -> None:
        """Drive along a route, map frame, from its beginning."""
        self._follower.set_path(route.points)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist; see `Explorer`."""
        navigator = self._navigator
        (navigator.sense if self._has_begun else navigator.reset)(reading)
        self._has_begun = True
        return self._follower.command(belief.pose, navigator.velocity, navigator.obstacles)
