"""Drives a robot back to where its map begins, once exploration is over."""

import numpy as np

from envs.estimation import Belief
from envs.navigation.navigator import Navigator
from envs.navigation.params import NavigatorParams, PlanningParams
from envs.navigation.paths import plan_path
from envs.navigation.planning_map import PlanningMap
from envs.navigation.records import DRIVING, FAILED, REACHED, REPLAN
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

HOME = (0.0, 0.0)
"""Where the map begins (x, y), map frame [m]."""
TOLERANCE = 0.2
"""Distance from there at which a path may end where the map shows an obstacle at home [m]."""
MAX_FAILURES = 3
"""Drives and searches without success after which the robot gives up."""


class HomeNavigator:
    """An `Explorer` that drives home by the shortest path through the map. Sees readings and beliefs alone.

    It begins anywhere with the first call of `act` and the map that there is then.
    """

    def __init__(
        self,
        robot: RobotParams,
        control_period: float,
        *,
        planning: PlanningParams = PlanningParams(),
        params: NavigatorParams = NavigatorParams(),
    ) -> None:
        """Prepare for a robot.

        Args:
            robot: the robot.
            control_period: time between two calls of `act` [s].
            planning: how paths are planned.
            params: how the drive goes.
        """
        self.end_reason: str | None = None
        """`"arrived_home"`, by the estimate, or `"no_path_home"`; None before."""
        self._robot, self._planning = robot, planning
        self._navigator = Navigator(robot, control_period, params)
        self._map: PlanningMap | None = None
        self._num_failures = 0

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._navigator.plan

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist; see `Explorer`."""
        if self.end_reason is not None:
            return Twist(0.0, 0.0)
        progress = self._update(reading, belief)
        if progress == REACHED:
            self.end_reason = "arrived_home"
            return Twist(0.0, 0.0)
        if progress != DRIVING:
            path = self._find_path(belief)
            self._num_failures += progress == FAILED or path is None
            if self._num_failures >= MAX_FAILURES:
                self.end_reason = "no_path_home"
                return Twist(0.0, 0.0)
            if path is None:
                self._navigator.spin()  # another look may show that what blocks the path has moved
            else:
                self._navigator.drive_to(path, keep_clocks=progress == REPLAN)
        return self._navigator.command(belief.pose)

    def _update(self, reading: Reading, belief: Belief) -> int:
        """Process a reading and what it has changed in the map; return the progress, see `Navigator.update`."""
        navigator, update = self._navigator, belief.update
        if self._map is None:
            self._map = PlanningMap(self._robot, belief.grid.resolution, self._planning)
            self._map.update(belief.grid, None)
            navigator.reset(reading)
            return REPLAN
        if update.redrawn:
            if update.correction is not None:
                navigator.carry(update.correction)
            navigator.plan_anew()
        self._map.update(belief.grid, update.window, redrawn=update.redrawn)
        return navigator.update(reading, belief.pose)

    def _find_path(self, belief: Belief) -> np.ndarray | None:
        """Return the path home for the largest footprint that has one, shape (n, 2), map frame [m]; None without."""
        assert self._map is not None
        for level in range(self._map.max_level + 1):
            costmap = self._map.costmap(level, belief.pose, self._navigator.obstacles)
            path = plan_path(costmap, belief.pose[:2], HOME, tolerance=TOLERANCE)
            if path is not None:
                return path
        return None
