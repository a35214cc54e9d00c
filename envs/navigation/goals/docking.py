"""Docking at a charging station, with the steps and gains of Nav2's docking server."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation.goals.goal_navigator import STOP, GoalNavigator
from lidarnaut.envs.navigation.maps.obstacles import free_distance
from lidarnaut.envs.simulation import Reading, Twist

DOCK_GAP, PROJECTION = 0.1, 0.15
"""Gap between docked footprint and station, bridged by charging contacts; distance from the docked pose to the target
behind it of the control law, which is singular at its target [m]."""
STAGING_DISTANCES = (0.9, 0.55, 1.25, 0.9)
"""Distances from the docked pose to the staging pose, of the first try and of each retry [m]."""
K_PHI, K_DELTA, BETA, LAMBDA = 3.0, 2.0, 0.4, 2.0
"""Gains k1, k2, beta and lambda of the control law."""
MIN_SPEED, MAX_SPEED, SLOWDOWN, STOP_DISTANCE = 0.02, 0.15, 0.5, 0.003
"""Approach: speed limits [m/s], speed per remaining distance [1/s], and remaining distance of the stop [m]."""
WAIT_TIME, BLOCKED_TIME, MAX_RETRIES = 1.0, 15.0, len(STAGING_DISTANCES) - 1
"""Time to wait for the charging current, and for obstacles to move away or the staging pose to become free [s]; maximum
number of retries."""
COLLISION_THRESHOLD, BACK_ROOM = 0.3, 0.1
"""Obstacles nearer to the station are ignored, as by Nav2's `dock_collision_threshold`; room needed to drive backwards
[m]."""
PATH_STEP, MAX_PATH_STEPS = 0.03, 100
"""Distance between the poses of the path that are checked for obstacles [m], and their maximum number."""
MAX_POINT_GAP, MAX_WIDTH, WIDTH_ERROR, MAX_OFFSET, MAX_TURN = 0.05, 0.8, 0.05, 0.3, 0.35
"""Detection of the station: maximum gap between neighbouring points, width, change of the width, and distance from the
expected position [m]; maximum difference from the expected heading [rad]."""
MIN_POINTS, MIN_DEPTH, MIN_SCORE, MAX_RESIDUAL = 5, 0.01, 6.0, 0.05
"""Detection of a station at a wall: minimum number of points on the front and on either side, distance that it stands
out [m], and this distance divided by its standard error; maximum standard deviation of the points [m]."""
MAX_AVERAGED = 20
"""Number of scans in the moving average of the station's pose."""


def find_front(points: np.ndarray, expected: Pose2D) -> tuple[Pose2D, float] | None:
    """Return pose and width [m] of the front of a station in a scan; None if no front is near the expected pose.

    The x axis of the pose points into the station. `points`: in the order of beams, shape (n, 2), base frame [m].
    """
    points = expected.inverse().transform(points)
    found = _find_isolated(points) or _find_raised(points)
    return None if found is None else (expected.compose(found[0]), found[1])


def _find_raised(points: np.ndarray) -> tuple[Pose2D, float] | None:
    """Find the part of a wall that stands out most: least squares of a line with a step, over all intervals."""
    points = points[(np.abs(points) < (MAX_OFFSET, MAX_WIDTH)).all(axis=1)]
    if len(points) < 20:
        return None
    x, y = (points - points.mean(axis=0)).T
    rest, index = x - (x @ y) / (y @ y) * y, np.arange(len(x) + 1)
    sums = (np.append(0.0, np.cumsum(values)) for values in (y, rest))
    count, sum_y, sum_rest = (np.subtract.outer(s, s).T for s in (index, *sums))
    spread = np.maximum(count - count**2 / len(x) - sum_y**2 / (y @ y), 1e-9)
    is_inside = (index >= MIN_POINTS) & (index <= len(x) - MIN_POINTS)
    is_front = is_inside & is_inside[:, None] & (count >= MIN_POINTS) & (-sum_rest >= MIN_DEPTH * spread)
    score = np.where(is_front, sum_rest**2 / spread, 0.0)
    i, j = np.unravel_index(score.argmax(), score.shape)
    variance = (rest @ rest - score[i, j]) / len(x)
    is_step = score[i, j] > MIN_SCORE**2 * variance and variance < MAX_RESIDUAL**2
    return _front_of(points[i:j]) if is_step else None


def _find_isolated(points: np.ndarray) -> tuple[Pose2D, float] | None:
    """Find the nearest cluster, if its neighbours are behind it."""
    breaks = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > MAX_POINT_GAP) + 1
    pairs = itertools.pairwise([0, *breaks.tolist(), len(points)])
    a, b = min(pairs, key=lambda ends: np.hypot(*points[slice(*ends)].T).min(initial=math.inf))
    found, sides = _front_of(points[a:b]), (points[max(a - 3, 0) : a], points[b : b + 3])
    if found is None or any(len(p) and found[0].inverse().transform(p)[:, 0].mean() < MAX_POINT_GAP for p in sides):
        return None
    return found


def _front_of(front: np.ndarray) -> tuple[Pose2D, float] | None:
    if len(front) < MIN_POINTS or (width := math.dist(front[0], front[-1])) > MAX_WIDTH:
        return None
    slope, offset = np.polyfit(front[:, 1], front[:, 0], 1).tolist()
    y = 0.5 * float(front[0, 1] + front[-1, 1])
    found = Pose2D(offset + slope * y, y, -math.atan(slope))
    is_near = math.hypot(found.x, found.y) <= MAX_OFFSET and abs(found.theta) <= MAX_TURN
    return (found, width) if is_near else None


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

    During the approach, the station's pose is an average over scans that show its front, moved by odometry. The robot
    waits for obstacles on its path to move away. `end_reason` is "blocked" or "not_charging" after the last retry.
    """

    def set_goal(self, goal: Sequence[float], heading: float | None = None) -> None:
        """Set the pose (x, y, theta) of the docked robot, map frame [m, rad]."""
        self._docked = Pose2D(*goal)
        self._tolerance, self._heading_tolerance = self.params.goal_tolerance, self.params.heading_tolerance
        self._num_retries = self._wait_steps = self._blocked_steps = 0
        self._is_backing = self._is_touched = False
        self._stage()

    def _stage(self) -> None:
        self._to_dock: Pose2D | None = None
        self._num_found, self._width = 0, 0.0
        staging = self._docked.compose(Pose2D(-STAGING_DISTANCES[self._num_retries], 0.0, 0.0))
        super().set_goal(staging[:2], staging.theta)

    def _retry(self, reason: str) -> None:
        self._num_retries, self._wait_steps, self._blocked_steps = self._num_retries + 1, 0, 0
        if self._num_retries > MAX_RETRIES:
            self.end_reason = reason
        elif self._to_dock is None or self._to_dock.x > STAGING_DISTANCES[1]:
            self._stage()
        else:
            self._is_backing = True

    def act(self, reading: Reading, belief: Belief) -> Twist:
        if self._to_dock is None:
            twist = super().act(reading, belief)
            self._blocked_steps += self._distance(belief.pose) < max(STAGING_DISTANCES)
            if self.end_reason == "arrived":
                self.end_reason, self._attempt.has_path, self._blocked_steps = None, False, 0
                self._to_dock = belief.pose.between(self._docked)
            elif self._blocked_steps * self._period > BLOCKED_TIME or self.end_reason in ("no_path", "stuck"):
                self._retry("blocked")
            return twist
        self._sense(reading, belief.pose)
        expected = self._navigator.motion.between(self._to_dock)
        self._to_dock = expected if self._blocked_steps else self._locate(expected)  # obstacles may hide the station
        twist = self._dock(reading, self._to_dock)
        self._is_touched = reading.bumper
        if twist.v:  # a robot that stops still rolls on
            self._navigator.note_command(twist)
        return twist

    def _dock(self, reading: Reading, to_dock: Pose2D) -> Twist:
        obstacles, is_docked = self._navigator.obstacles, to_dock.x <= STOP_DISTANCE
        if self._is_backing:
            has_room = free_distance(obstacles, 0.0, self._robot.radius, -BACK_ROOM) == BACK_ROOM
            self._is_backing = to_dock.x < STAGING_DISTANCES[0] and has_room
            return Twist(-MAX_SPEED, 0.0) if has_room else STOP
        twist, is_touched = STOP, reading.bumper and not (self._is_touched or is_docked)
        if reading.extra.get("battery", (0.0, 0.0))[1]:  # charging
            self._wait_steps = 0
        elif is_docked:
            self._wait_steps += 1
        elif self._is_blocked(to_dock, obstacles):
            self._blocked_steps += 1
        else:
            twist, self._blocked_steps = self._approach(to_dock), self._blocked_steps + 1 if reading.bumper else 0
        is_late = self._wait_steps * self._period > WAIT_TIME or self._blocked_steps * self._period > BLOCKED_TIME
        if is_late or is_touched:
            self._retry("not_charging" if is_docked else "blocked")
            return STOP
        return twist

    def _approach(self, to_dock: Pose2D) -> Twist:
        speed = min(max(SLOWDOWN * to_dock.x, MIN_SPEED), MAX_SPEED, self._robot.max_v)
        return approach(to_dock.compose(Pose2D(PROJECTION, 0.0, 0.0)), speed)

    def _is_blocked(self, to_dock: Pose2D, points: np.ndarray) -> bool:
        """Return whether obstacles far enough from the station overlap the footprint on the path to the docked pose."""
        radius = self._robot.radius
        front = to_dock.compose(Pose2D(radius + DOCK_GAP, 0.0, 0.0))
        is_far = np.hypot(*(points - front[:2]).T) > COLLISION_THRESHOLD
        points = points[is_far & (np.hypot(*points.T) > radius)]  # contacts are not always in front
        for _ in range(MAX_PATH_STEPS):
            if to_dock.x <= STOP_DISTANCE:
                break
            twist = self._approach(to_dock)
            step = Pose2D(PATH_STEP, 0.0, PATH_STEP * twist.w / twist.v)
            to_dock, points = step.between(to_dock), step.inverse().transform(points)
            if (np.hypot(*points.T) < self._navigator.numbers["tight_reach"]).any():
                return True
        return False

    def _locate(self, expected: Pose2D) -> Pose2D:
        to_front = Pose2D(self._robot.radius + DOCK_GAP, 0.0, 0.0)
        found = find_front(self._navigator.visible, expected.compose(to_front))
        if found is None or found[1] < self._width - WIDTH_ERROR:  # a part of the front
            return expected
        self._num_found = 1 if found[1] > self._width + WIDTH_ERROR else self._num_found + 1
        self._width = max(self._width, found[1])
        change = np.array(expected.between(found[0].compose(to_front.inverse())))
        return expected.compose(Pose2D(*(change / min(self._num_found, MAX_AVERAGED)).tolist()))
