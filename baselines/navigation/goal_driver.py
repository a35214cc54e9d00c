"""The policies of tasks with a goal: a navigator on the map that the robot has, or makes."""

from dataclasses import replace

import numpy as np

from baselines.navigation.map_navigator import MapNavigator
from baselines.navigation.params import DEFAULTS, MapNavigatorParams
from envs.estimation import Belief
from envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

MARGIN = 3.0
"""Unknown space around a map that grows, and around a goal beyond it, through which paths may lead [m]."""


class GoalDriver:
    """Drives to the task's goal with a `MapNavigator`: on a known map, or on one that a SLAM makes meanwhile.

    On a map that grows, paths may cross unknown space, and another one is planned when what comes into view blocks it.
    """

    def __init__(self, params: MapNavigatorParams = DEFAULTS) -> None:
        self._params = params
        self.navigator: MapNavigator | None = None
        """What drives; None before the first `act` of an episode."""
        self._problem: str | None = None

    @property
    def end_reason(self) -> str | None:
        """Why the drive has ended, None while it has not: the navigator's reason, or "refused" or "elsewhere".

        It is refused where the map has an obstacle at the goal, and elsewhere if only the estimated position is there:
        otherwise the task would have ended.
        """
        reason = self._problem or (self.navigator.end_reason if self.navigator else None)
        return "elsewhere" if reason == "reached" else reason

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self.navigator.plan if self.navigator else None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._period, self._rng = robot, control_period, rng
        self.navigator, self._problem = None, None
        self._is_new = self._grows = False

    def set_goal(self, goal: Pose2D) -> None:
        """Drive to a goal, map frame, from the next `act` on; its heading does not matter."""
        self._goal, self._is_new, self._problem = goal[:2], True, None

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist; see `Explorer`."""
        has_changed = belief.update.window is not None or belief.update.redrawn
        if self.navigator is None:
            self._grows, self._map_time = has_changed, reading.time
            params = replace(self._params, allow_unknown=self._grows or self._params.allow_unknown)
            self.navigator = MapNavigator(self._robot, self._period, self._map(belief), self._rng, params)
            self._is_stale = False
        self._is_stale |= has_changed
        if self._is_new:
            self._is_new = False
            try:
                self.navigator.set_goal(self._goal)
            except ValueError:
                self._problem = "refused"
        if self._is_stale and reading.time - self._map_time >= self._params.update_period:
            self._is_stale, self._map_time = False, reading.time
            self.navigator.set_map(self._map(belief))
        return self.navigator.act(reading, belief)

    def _map(self, belief: Belief) -> OccupancyGrid:
        """Return the map to drive on; of one that grows a copy, with the goal and a margin on it."""
        grid = belief.grid
        if not self._grows:
            return grid
        (x0, y0, x1, y1), (x, y) = grid.bounds, self._goal
        beyond = (y0 - y, y - y1), (x0 - x, x - x1)
        pads = [[round((MARGIN + max(gap, 0.0)) / grid.resolution) for gap in gaps] for gaps in beyond]
        origin = x0 - pads[1][0] * grid.resolution, y0 - pads[0][0] * grid.resolution
        return OccupancyGrid(np.pad(grid.data, pads, constant_values=UNKNOWN), grid.resolution, origin)
