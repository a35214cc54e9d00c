"""One robot that explores by frontier points: drives to the point that it is assigned, yields, and waits."""

import numpy as np

from baselines.rrt.navigator import PointNavigator
from baselines.rrt.params import RrtParams
from baselines.rrt.right_of_way import find_waiting_cell, is_beside
from envs.estimation import Belief
from envs.geometry import Pose2D
from envs.navigation import NO_POINTS, travel_field
from envs.navigation.records import DRIVING, REPLAN
from envs.robots import RobotParams
from envs.simulation import Reading

PAUSE_TIME = 1.0
"""Time between two searches for a point, while a robot has none and others have [s]."""
BLOCKED_TIME = 1.0
"""Time without progress after which a robot is blocked [s]."""
PASSED_CLEARANCE = 0.5
"""Gap between the footprint of a waiting robot and the path of the other one from which that one has passed [m]."""
MAX_WAIT = 15.0
"""Longest time to wait [s]."""


class RrtRobot:
    """Decides how to get to the point that it is assigned. Sees readings and beliefs, never ground truth."""

    def __init__(self, robot: RobotParams, control_period: float, params: RrtParams, index: int) -> None:
        """Prepare for an episode of a robot with an index in its team, updated every `control_period` seconds."""
        self.index = index
        self.navigator = PointNavigator(robot, control_period, params)
        self.end_reason: str | None = None
        """Why it has stopped exploring; None while it has not."""
        self.yielding_to: RrtRobot | None = None
        """The robot that it lets pass."""
        self.blocking, self.passing = NO_POINTS, NO_POINTS
        """Outlines of the peers that plans lead around, and of those that they lead through; base frame [m]."""
        self.idle_steps = 0
        """Control steps without a point."""
        self._radius, self._period = robot.radius, control_period
        self._has_begun = self._has_looked_around = False
        self._pause_steps = self._wait_steps = 0

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self.navigator.plan if self._has_begun else None

    @property
    def target(self) -> tuple[float, float] | None:
        """The frontier that it drives to (x, y), map frame [m]; None without one."""
        is_driving = self._has_begun and self.navigator.navigator.has_goal and self.yielding_to is None
        return self.navigator.target if is_driving else None

    @property
    def precedence(self) -> tuple[bool, int]:
        """The robot with the lower one has the right of way."""
        return self.target is None, self.index

    @property
    def is_blocked(self) -> bool:
        """Whether it drives to a goal and makes no progress."""
        if not self._has_begun:
            return False
        drive = self.navigator.navigator
        return drive.has_goal and not drive.is_recovering and drive.still_steps * self._period > BLOCKED_TIME

    @property
    def is_idle(self) -> bool:
        """Whether it has begun, and has nothing to do."""
        drive = self.navigator.navigator
        return self._has_begun and not drive.has_goal and not drive.is_recovering and self.yielding_to is None

    def update(self, reading: Reading, belief: Belief, points: np.ndarray, *, is_asked: bool) -> bool:
        """Process a reading, without peers, and tell whether the robot is to be assigned one of the frontier points.

        `points` have the shape (n, 2), float64, map frame [m]. A robot that `is_asked` looks for one even in a pause.
        """
        navigator = self.navigator
        navigator.points, navigator.bodies = points, self.blocking
        self.idle_steps = 0 if self.target is not None else self.idle_steps + 1
        self._pause_steps -= 1
        others = np.concatenate([self.blocking, self.passing])
        if not self._has_begun:
            self._has_begun = True
            navigator.begin(reading, belief)
            return True
        if self.yielding_to is not None:
            if navigator.drive(reading, belief, others) not in (DRIVING, REPLAN):
                navigator.stop()
            if not self._has_passed(self.yielding_to, belief.pose):
                return False
            self.yielding_to = None
            navigator.stop()
        elif self.is_idle and self._pause_steps > 0 and not is_asked:
            navigator.drive(reading, belief, others)
            return False
        return navigator.update(reading, belief, others) is not None

    def learn(self, belief: Belief) -> None:
        """Take note of what another robot's scan has changed in the map."""
        if self._has_begun:
            self.navigator.integrate(belief)

    def open_goals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what may be assigned: candidates that have failed only if there are no others.

        These are frontiers, shape (k, 2), map frame [m], the costs of the paths to their viewpoints [m], and their
        indices among the candidates.
        """
        candidates = self.navigator.candidates
        indices = np.flatnonzero(candidates.failures == 0)
        if len(indices) == 0:
            indices = np.arange(len(candidates))
        return candidates.frontiers[indices], candidates.costs[indices], indices

    def choose(self, index: int) -> None:
        """Drive to a candidate of the navigator."""
        self._has_looked_around, self.end_reason = False, None
        self.navigator.choose(index)

    def wait(self) -> None:
        """Stop for a while, since others have all the points."""
        self._has_looked_around, self.end_reason = False, None
        self.navigator.stop()
        self._pause_steps = max(1, round(PAUSE_TIME / self._period))

    def look_around_or_end(self, patience: int) -> None:
        """Turn once around where no point is left; then end, if there has been none for `patience` steps."""
        if not self._has_looked_around:
            self._has_looked_around = True
            self.navigator.look_around()
        elif self.idle_steps >= patience:
            self.end_reason = self.navigator.end_reason
            self.navigator.stop()

    def yield_to(self, other: "RrtRobot", pose: Pose2D) -> bool:
        """Drop the own goal and drive off the path of another robot; False if there is nowhere to go."""
        path = other.plan
        field = None if path is None else travel_field(self.navigator.free_costmap(pose), pose[:2])
        cell = None if path is None or field is None else find_waiting_cell(field, path, self._radius)
        route = None if field is None or cell is None else field.path(*cell)
        if route is None:
            return False
        self.navigator.navigator.drive_to(route)
        self.yielding_to, self._wait_steps = other, 0
        return True

    def _has_passed(self, other: "RrtRobot", pose: Pose2D) -> bool:
        path = other.plan
        if path is None:
            return True
        if self.navigator.navigator.has_goal:
            return False
        self._wait_steps += 1
        is_off = not is_beside(pose[:2], path, 2.0 * self._radius + PASSED_CLEARANCE)
        return is_off or self._wait_steps * self._period > MAX_WAIT
