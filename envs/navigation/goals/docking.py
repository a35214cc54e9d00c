"""Docking at a charging station, with the steps and gains of Nav2's docking server."""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation.goals.goal_navigator import STOP, GoalNavigator
from lidarnaut.envs.simulation import Reading, Twist

DOCK_GAP, STAGING_DISTANCE, PROJECTION = 0.1, 0.9, 0.15
"""Gap between docked footprint and station, bridged by charging contacts; distances from the docked pose to the staging
pose and, behind it, to the target of the control law, which is singular at its target [m]."""
K_PHI, K_DELTA, BETA, LAMBDA = 3.0, 2.0, 0.4, 2.0
"""Gains k1, k2, beta and lambda of the control law."""
MIN_SPEED, MAX_SPEED, SLOWDOWN, STOP_DISTANCE = 0.02, 0.15, 0.5, 0.003
"""Approach: speed limits [m/s], speed per remaining distance [1/s], and remaining distance of the stop [m]."""
WAIT_TIME, MAX_RETRIES = 1.0, 3
"""Time to wait for the charging current [s], and maximum number of retries."""
MAX_POINT_GAP, MAX_WIDTH, WIDTH_ERROR, MAX_OFFSET, MAX_TURN = 0.05, 0.8, 0.05, 0.3, 0.35
"""Detection of the station: maximum gap between neighbouring points, width, change of the width, and distance from the
expected position [m]; maximum difference from the expected heading [rad]."""
MAX_AVERAGED = 20
"""Number of scans in the moving average of the station's pose."""


def find_front(points: np.ndarray, expected: Pose2D) -> tuple[Pose2D, float] | None:
    """Return pose and width [m] of the front of a station in a scan; None if no front is near the expected pose.

    The x axis of the pose points into the station. `points`: in the order of beams, shape (n, 2), base frame [m].
    """
    breaks = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > MAX_POINT_GAP) + 1
    clusters = np.split(expected.inverse().transform(points), breaks)
    front = min(clusters, key=lambda cluster: np.hypot(*cluster.T).min(initial=math.inf))
    if len(front) < 5 or (width := math.dist(front[0], front[-1])) > MAX_WIDTH:
        return None
    slope, offset = np.polyfit(front[:, 1], front[:, 0], 1).tolist()
    y = 0.5 * float(front[0, 1] + front[-1, 1])
    found = Pose2D(offset + slope * y, y, -math.atan(slope))
    is_near = math.hypot(found.x, found.y) <= MAX_OFFSET and abs(found.theta) <= MAX_TURN
    return (expected.compose(found), width) if is_near else None


def approach(target: Pose2D, speed: float) -> Twist:
    """Return the twist towards a pose, base frame, at most at `speed` [m/s].

    Park and Kuipers, "A Smooth Control Law for Graceful Motion of Differential Wheeled Mobile Robots in 2D Environment"
    (2011), equations 13 and 15.
    """
    r, delta = math.hypot(target.x, target.y), -math.atan2(target.y, target.x)
    phi = wrap_angle(target.theta + delta)
    turn = K_DELTA * (delta - math.atan(-K_PHI * phi)) + (1.0 + K_PHI / (1.0 + (K_PHI * phi) ** 2)) * math.sin(delta)
    v = speed / (1.0 + BETA * abs(turn / r) ** LAMBDA)
    return Twist(v, -v * turn / r)


class DockNavigator(GoalNavigator):
    """Docks a robot at a charging station: drives to a staging pose, approaches by the scan, and retries.

    During the approach, the station's pose is an average over scans that show its front, moved by odometry.
    """

    def set_goal(self, goal: Sequence[float], heading: float | None = None) -> None:
        """Set the pose (x, y, theta) of the docked robot, map frame [m, rad]."""
        self._docked = Pose2D(*goal)
        self._to_dock: Pose2D | None = None
        staging = self._docked.compose(Pose2D(-STAGING_DISTANCE, 0.0, 0.0))
        self._tolerance, self._heading_tolerance = self.params.goal_tolerance, self.params.heading_tolerance
        super().set_goal(staging[:2], staging.theta)
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
        self._to_dock = to_dock = self._locate(self._navigator.motion.between(self._to_dock))
        if self._is_backing:
            self._is_backing = to_dock.x < STAGING_DISTANCE
            return Twist(-MAX_SPEED, 0.0)
        if reading.extra.get("battery", (0.0, 0.0))[1]:  # charging
            self._wait_steps = 0
        elif to_dock.x > STOP_DISTANCE and not reading.bumper:
            speed = min(max(SLOWDOWN * to_dock.x, MIN_SPEED), MAX_SPEED, self._robot.max_v)
            return approach(to_dock.compose(Pose2D(PROJECTION, 0.0, 0.0)), speed)
        else:
            self._wait_steps += 1
        if self._wait_steps * self._period > WAIT_TIME:
            self._num_retries, self._wait_steps, self._is_backing = self._num_retries + 1, 0, True
            self.end_reason = "not_charging" if self._num_retries > MAX_RETRIES else None
        return STOP

    def _locate(self, expected: Pose2D) -> Pose2D:
        to_front = Pose2D(self._robot.radius + DOCK_GAP, 0.0, 0.0)
        found = find_front(self._navigator.visible, expected.compose(to_front))
        if found is None or found[1] < self._width - WIDTH_ERROR:  # a part of the front
            return expected
        self._num_found = 1 if found[1] > self._width + WIDTH_ERROR else self._num_found + 1
        self._width = max(self._width, found[1])
        change = np.array(expected.between(found[0].compose(to_front.inverse())))
        return expected.compose(Pose2D(*(change / min(self._num_found, MAX_AVERAGED)).tolist()))
