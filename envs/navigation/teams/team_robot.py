import math
from typing import Any

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.geometry.lines import lengths_along
from lidarnaut.envs.navigation.controllers.navigator_kernels import DRIVING, REPLAN
from lidarnaut.envs.navigation.frontiers.frontier_navigator import FrontierNavigator
from lidarnaut.envs.navigation.maps.obstacles import NO_POINTS
from lidarnaut.envs.navigation.search.paths import TravelField, travel_field
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading

PASSING_CLEARANCE = 0.15
"""Minimum gap between the footprints of a waiting and a passing robot [m]."""
OUTLINE_POINTS = 16
PAUSE_TIME = 1.0
"""Time between frontier searches while all frontiers are assigned to other robots [s]."""
BLOCKED_TIME = 1.0
"""Time without progress after which a robot counts as blocked [s]."""
PASSED_CLEARANCE = 0.5
"""A robot stops waiting once the remaining path of the passing robot keeps this gap between their footprints [m]."""
MAX_WAIT = 15.0


def outline(pose: Pose2D, peer: Pose2D, radius: float) -> np.ndarray:
    """Return the circular outline of another robot as obstacle points, shape (16, 2), base frame [m].

    `pose`, `peer`: poses of this and the other robot, map frame. `radius`: radius of the outline [m].
    """
    away = pose.between(peer)
    angles = np.linspace(0.0, 2.0 * math.pi, OUTLINE_POINTS, endpoint=False)
    return np.array(away[:2]) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def is_beside(position: tuple[float, float], path: np.ndarray, gap: float, reach: float = math.inf) -> bool:
    """Return True if a position is within `gap` [m] of the first `reach` metres of a path, shape (n, 2), n > 0."""
    return bool(np.hypot(*(path[lengths_along(path) <= reach] - position).T).min() < gap)


def find_waiting_cell(field: TravelField, path: np.ndarray, radius: float) -> tuple[int, int] | None:
    """Return the cell (row, column) of lowest path cost that lets another robot pass; None for none.

    `field`: path costs from the waiting robot. `path`: path of the other robot, shape (n, 2), n > 0, map frame [m].
    `radius`: footprint radius of both [m].
    """
    grid = field.costmap.grid
    cells = grid.cells(path)
    cells = cells[grid.contains(cells)]
    on_path = np.zeros(grid.data.shape, dtype=np.bool_)
    on_path[cells[:, 0], cells[:, 1]] = True
    reach = math.ceil((2.0 * radius + PASSING_CLEARANCE) / grid.resolution)
    off_path = np.argwhere(squared_distances(on_path, reach) > reach**2)
    costs = field.cost(off_path)
    if len(costs) == 0 or math.isinf(costs.min()):
        return None
    row, col = off_path[np.argmin(costs)]
    return int(row), int(col)


class TeamRobot(FrontierNavigator):
    """Frontier navigator of one robot in a team. The robot yields to teammates with the right of way."""

    def __init__(
        self, robot: RobotParams, control_period: float, index: int, *, patience: int = 1, **limits: Any
    ) -> None:
        """Create a navigator for one robot of a team.

        `patience`: number of control periods without a reachable frontier before exploration ends. `limits`: further
        arguments of `FrontierNavigator`.
        """
        super().__init__(robot, control_period, **limits)
        self.index = index
        self.ended: str | None = None
        """Reason why the robot stopped exploring; None while exploring."""
        self.yielding_to: TeamRobot | None = None
        self.passing = NO_POINTS
        """Obstacle points on teammates that must yield to this robot, shape (n, 2), base frame [m]. Ignored by path
        planning."""
        self.outcome: str | None = None
        self._patience, self._radius, self._period = patience, robot.radius, control_period
        self._has_looked_around = self._keeps_clocks = False
        self._idle_steps = self._pause_steps = self._wait_steps = 0

    @property
    def driving_to(self) -> tuple[float, float] | None:
        """Frontier that the robot drives to (x, y), map frame [m]; None without a frontier."""
        return self.target if self.navigator.has_goal and self.yielding_to is None else None

    @property
    def precedence(self) -> tuple[bool, int]:
        """Sort key of the right of way: the robot with the lower value goes first."""
        return self.driving_to is None, self.index

    @property
    def is_blocked(self) -> bool:
        """True if a driving robot has made no progress for `BLOCKED_TIME`."""
        drive = self.navigator
        return drive.has_goal and not drive.is_recovering and drive.record["stall_steps"] * self._period > BLOCKED_TIME

    @property
    def is_idle(self) -> bool:
        """True while the robot does not drive, recover or yield."""
        is_busy = self.navigator.has_goal or self.navigator.is_recovering or self.yielding_to is not None
        return self.candidates is not None and not is_busy

    def advance(self, reading: Reading, belief: Belief, *, is_asked: bool) -> bool:
        """Process a sensor reading; return True if the robot needs a new frontier.

        `reading`: beams on teammates are NaN. `is_asked`: search for frontiers even during a pause (see `wait`).
        """
        self._idle_steps = 0 if self.driving_to is not None else self._idle_steps + 1
        self._pause_steps -= 1
        self._keeps_clocks = False
        others = np.concatenate([self.bodies, self.passing])
        if self.candidates is None:
            self.begin(reading, belief)
            return True
        if self.yielding_to is not None:
            if self.drive(reading, belief, others) not in (DRIVING, REPLAN):
                self.navigator.stop()
            if not self._has_passed(self.yielding_to, belief.pose):
                return False
            self.yielding_to = None
            self.navigator.stop()
        elif self.is_idle and self._pause_steps > 0 and not is_asked:
            self.drive(reading, belief, others)
            return False
        self.outcome = self.update(reading, belief, others)
        return self.outcome is not None

    def refresh(self, reading: Reading, belief: Belief) -> None:
        """Find reachable frontiers during a drive. Choosing one of them does not restart the drive's time limits."""
        self._keeps_clocks = True
        self.find_candidates(reading, belief)

    def choose(self, index: int, *, keep_clocks: bool = False) -> None:
        self._has_looked_around, self.ended = False, None
        super().choose(index, keep_clocks=keep_clocks or self._keeps_clocks)

    def wait(self) -> None:
        """Stop for `PAUSE_TIME` while all frontiers are assigned to other robots."""
        self._has_looked_around, self.ended = False, None
        self.navigator.stop()
        self._pause_steps = max(1, round(PAUSE_TIME / self._period))

    def look_around_or_end(self) -> None:
        """Look around if no frontier is left; end exploration after `patience` idle control periods."""
        if not self._has_looked_around:
            self._has_looked_around = True
            self.look_around()
        elif self._idle_steps >= self._patience:
            self.ended = self.end_reason
            self.navigator.stop()

    def yield_to(self, other: "TeamRobot", pose: Pose2D) -> bool:
        """Drive off another robot's path; return False if no waiting cell is reachable."""
        path = other.plan
        field = None if path is None else travel_field(self.free_costmap(pose), pose[:2])
        cell = None if path is None or field is None else find_waiting_cell(field, path, self._radius)
        route = None if field is None or cell is None else field.path(*cell)
        if route is None:
            return False
        self.navigator.drive_to(route)
        self.yielding_to, self._wait_steps, self._is_looking = other, 0, False
        return True

    def _has_passed(self, other: "TeamRobot", pose: Pose2D) -> bool:
        path = other.plan
        if path is None:
            return True
        if self.navigator.has_goal:
            return False
        self._wait_steps += 1
        is_off = not is_beside(pose[:2], path, 2.0 * self._radius + PASSED_CLEARANCE)
        return is_off or self._wait_steps * self._period > MAX_WAIT

    def _replan(self, pose: Pose2D) -> bool:
        if super()._replan(pose):
            return True
        bodies, self.bodies = self.bodies, NO_POINTS
        has_path = len(bodies) > 0 and super()._replan(pose)
        self.bodies = bodies
        return has_path
