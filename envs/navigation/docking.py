"""Docking at a charging station: drive to a staging pose, find the station in the scan, approach, retry.

Conventions as in Nav2's docking server, with the control law of Park and Kuipers, "A Smooth Control Law for Graceful
Motion of Differential Wheeled Mobile Robots in 2D Environment" (2011).
"""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation.goal_navigator import STOP, GoalNavigator
from lidarnaut.envs.simulation import Reading, Twist

DOCK_GAP = 0.1
"""Gap between the footprint of a docked robot and the front of the station [m], bridged by charging contacts."""
STAGING_DISTANCE = 0.9
"""Distance from the staging pose to the docked pose [m]."""
PROJECTION = 0.15
"""Distance behind the docked pose of the pose that the control law approaches [m]; this avoids its singularity."""
K_PHI, K_DELTA, BETA, LAMBDA = 3.0, 2.0, 0.4, 2.0
"""Gains k1, k2, beta and lambda of the control law, as in Nav2."""
MIN_SPEED, MAX_SPEED, SLOWDOWN = 0.02, 0.15, 0.5
"""Speed limits of the approach [m/s], and decrease of the speed with the distance [1/s]."""
STOP_DISTANCE = 0.003
"""Remaining distance at which the approach ends [m]."""
WAIT_TIME, MAX_RETRIES = 1.0, 3
"""Time to wait for the charging current before a retry [s], and maximum number of retries."""
MAX_POINT_GAP, MAX_WIDTH, WIDTH_ERROR = 0.05, 0.8, 0.05
"""Limits of a station in a scan: gap between neighbouring points, width, and change of the width [m]."""
MAX_OFFSET, MAX_TURN = 0.3, 0.35
"""Maximum difference between detected and expected station [m, rad]."""
MAX_AVERAGED = 20
"""Number of detections in the moving average of the station's pose."""


def find_front(points: np.ndarray, expected: Pose2D) -> tuple[Pose2D, float] | None:
    """Return pose and width [m] of the front of a station in a scan, or None if no front is near the expected pose.

    The front is the cluster of points nearest to the expected pose; its pose is its middle and the normal that points
    into the station. `points`: in the order of the beams, shape (n, 2), base frame [m]; `expected`: base frame.
    """
    if len(points) < 2:
        return None
    breaks = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > MAX_POINT_GAP) + 1
    clusters = np.split(expected.inverse().transform(points), breaks)
    front = min(clusters, key=lambda cluster: np.hypot(*cluster.T).min())
    width = math.dist(front[0], front[-1])
    if len(front) < 5 or width > MAX_WIDTH:
        return None
    slope, offset = np.polyfit(front[:, 1], front[:, 0], 1).tolist()
    y = 0.5 * float(front[0, 1] + front[-1, 1])
    found = Pose2D(offset + slope * y, y, -math.atan(slope))
    is_near = math.hypot(found.x, found.y) <= MAX_OFFSET and abs(found.theta) <= MAX_TURN
    return (expected.compose(found), width) if is_near else None


def approach(target: Pose2D, speed: float) -> Twist:
    """Return the twist towards a pose (base frame) by Park and Kuipers (2011), equations 13 and 15.

    `speed`: maximum forward speed [m/s].
    """
    r, bearing = math.hypot(target.x, target.y), math.atan2(target.y, target.x)
    phi, delta = wrap_angle(target.theta - bearing), -bearing
    turn = K_DELTA * (delta - math.atan(-K_PHI * phi)) + (1.0 + K_PHI / (1.0 + (K_PHI * phi) ** 2)) * math.sin(delta)
    curvature = -turn / r
    v = speed / (1.0 + BETA * abs(curvature) ** LAMBDA)
    return Twist(v, v * curvature)


class DockNavigator(GoalNavigator):
    """Docks a robot at a charging station whose pose on the map is known.

    The goal is the pose of the docked robot. In front of the station, the scan replaces the map: the pose of the
    station is the average over scans that show its front, moved by odometry.
    """

    def set_tolerances(self, distance: float, heading: float) -> None:
        """Ignore the tolerances of the task; the staging pose needs no accuracy."""

    def set_goal(self, goal: Sequence[float], heading: float | None = None) -> None:
        """Set the pose (x, y, theta) of the docked robot, map frame [m, rad]."""
        self._docked = Pose2D(*goal)
        staging = self._docked.compose(Pose2D(-STAGING_DISTANCE, 0.0, 0.0))
        super().set_goal(staging[:2], staging.theta)
        self._to_dock: Pose2D | None = None
        """Docked pose, base frame; None before the approach."""
        self._num_retries = self._num_found = self._wait_steps = 0
        self._is_backing, self._width = False, 0.0

    def act(self, reading: Reading, belief: Belief) -> Twist:
        if self._to_dock is None:
            twist = super().act(reading, belief)
            if self.end_reason == "arrived":
                self.end_reason, self._has_path = None, False
                self._to_dock = belief.pose.between(self._docked)
            return twist
        self._sense(reading, belief.pose)
        self._to_dock = to_dock = self._locate(reading, self._navigator.motion.between(self._to_dock))
        if reading.extra.get("battery", (0.0, 0.0))[1]:  # charging
            self._wait_steps = 0
            return STOP
        if self._is_backing:
            self._is_backing = to_dock.x < STAGING_DISTANCE
            return Twist(-MAX_SPEED, 0.0)
        if to_dock.x > STOP_DISTANCE and not reading.bumper:
            speed = min(max(SLOWDOWN * to_dock.x, MIN_SPEED), MAX_SPEED, self._robot.max_v)
            return approach(to_dock.compose(Pose2D(PROJECTION, 0.0, 0.0)), speed)
        self._wait_steps += 1
        if self._wait_steps * self._period > WAIT_TIME:
            self._num_retries, self._wait_steps, self._is_backing = self._num_retries + 1, 0, True
            self.end_reason = "not_charging" if self._num_retries > MAX_RETRIES else None
        return STOP

    def _locate(self, reading: Reading, expected: Pose2D) -> Pose2D:
        lidar = self._robot.lidar
        is_hit = np.isfinite(reading.ranges)
        points = (reading.ranges[is_hit] * lidar.directions[:, is_hit]).T + (lidar.mount.x, lidar.mount.y)
        to_front = Pose2D(self._robot.radius + DOCK_GAP, 0.0, 0.0)
        found = find_front(points, expected.compose(to_front))
        if found is None or (self._num_found and abs(found[1] - self._width) > WIDTH_ERROR):
            return expected
        self._num_found, self._width = self._num_found + 1, self._width or found[1]
        change = expected.between(found[0].compose(to_front.inverse()))
        share = 1.0 / min(self._num_found, MAX_AVERAGED)
        return expected.compose(Pose2D(share * change.x, share * change.y, share * change.theta))
