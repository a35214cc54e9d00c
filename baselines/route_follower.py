"""Route following by the fused pose: the classic policy of `lidarnaut/Track-v0`, and of all tasks with a route."""

import numpy as np

from envs.estimation import Belief
from envs.navigation import FollowerParams, Navigator, PathFollower
from envs.robots import RobotParams
from envs.simulation import Reading, Twist
from envs.tasks.route import Route

LOOKAHEAD_TIME = 0.75
"""Lookahead over speed [s]: half of the path follower's, because a route is smooth where a raster's path is not."""
MIN_TURN_TIME = 1.0
"""Arcs whose radius is driven through in less than this at full speed are driven more slowly [s]."""
ROTATE_FROM = 1.6
"""Angle from which the robot stops and turns on the spot [rad]: a rounded corner of 90 degrees is driven through."""


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
