"""Route following by the fused pose: the classic policy of `TrackEnv`."""

import numpy as np

from baselines.obstacles import ObstacleMemory
from envs.geometry import Pose2D
from envs.navigation.path_follower import FollowerParams, PathFollower
from envs.robots import RobotParams
from envs.simulation import Twist
from envs.tasks.route import Route

LOOKAHEAD_TIME = 0.75
"""Lookahead over speed [s]: half of the path follower's, because a route is smooth where a raster's path is not."""
MIN_TURN_TIME = 1.0
"""Arcs whose radius is driven through in less than this at full speed are driven more slowly [s]."""
ROTATE_FROM = 1.6
"""Angle from which the robot stops and turns on the spot [rad]: a rounded corner of 90 degrees is driven through."""


class RouteFollower:
    """Drives a route with the path follower, from the scan, the filter's velocities and the fused pose."""

    def reset(self, robot: RobotParams, control_period: float, route: Route) -> None:
        """Prepare for a route.

        Args:
            robot: the robot that will be driven.
            control_period: time between two calls of `act` [s].
            route: what to follow, map frame.
        """
        self._robot = robot
        self._obstacles = ObstacleMemory(robot, control_period)
        params = FollowerParams(lookahead_time=LOOKAHEAD_TIME, min_turn_time=MIN_TURN_TIME, rotate_from=ROTATE_FROM)
        self._follower = PathFollower(robot, control_period, params)
        self._follower.set_path(route.points)

    def act(self, observation: dict[str, np.ndarray], pose: Pose2D) -> np.ndarray:
        """Return the action, shape (2,), float32: forward speed and yaw rate as fractions of the robot's limits.

        Args:
            observation: of `TrackEnv`.
            pose: fused pose of the base, map frame.
        """
        robot, motion = self._robot, observation["motion"]
        obstacles = self._obstacles.update(observation["scan"], motion)
        twist = Twist(float(motion[0]) * robot.max_v, float(motion[1]) * robot.max_w)
        command = self._follower.command(pose, twist, obstacles)
        v, w = command.v / robot.max_v, command.w / robot.max_w
        return np.clip([v, w], -1.0, 1.0).astype(np.float32)
