"""Planners for robots that something else drives. Observation parts and policies share them, see `Robot.planner`."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation.frontiers.frontier_navigator import FrontierNavigator
from lidarnaut.envs.navigation.goals.goal_navigator import GoalNavigator, GoalParams
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

WITHOUT_LIMITS = GoalParams(max_recoveries=None, max_searches=None, search_radius=1.0)
Rating = Callable[[FrontierNavigator, Belief], np.ndarray]
"""Function that returns a score for each candidate of a navigator, shape (k,), float64, k >= 0."""


class GoalPlanner:
    """Plans the path to a goal as `GoalNavigator` does, and never gives up."""

    nearest = 0
    """Index of the path point nearest to the robot, updated while the path is followed; 0 for a new path."""

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        self._navigator = GoalNavigator(WITHOUT_LIMITS)
        # only reactive driving uses the generator
        self._navigator.reset(robot, control_period, np.random.default_rng(0))
        self._reading: Reading | None = None
        self._path = np.empty((0, 2))

    def update(
        self,
        reading: Reading,
        belief: Belief,
        goal: Sequence[float],
        tolerances: tuple[float, float] = (math.inf, math.pi),
    ) -> np.ndarray:
        """Process a new reading, and return the path to `goal` (x, y[, theta]), shape (n, 2), map frame [m].

        Before the first plan, the path is the goal alone. At the goal, it leads to points around, since the estimated
        pose is inaccurate. `tolerances`: those of the task, as for `GoalNavigator.set_tolerances`.
        """
        navigator = self._navigator
        if reading is not self._reading:
            self._reading = reading
            if navigator.goal != tuple(goal[:2]):
                navigator.set_tolerances(*tolerances)
                navigator.set_goal(goal)
            navigator.act(reading, belief)
            if navigator.plan is not None and len(navigator.plan):
                self._path, self.nearest = navigator.plan, 0
        return np.vstack([self._path, navigator.target or goal[:2]])


class FrontierPlanner:
    """Plans the paths to the best frontiers as `FrontierNavigator` does.

    Frontiers are detected every `max_time` seconds, and when the best one is reached.
    """

    num_paths = 1
    """Maximum number of paths."""
    paths: Sequence[np.ndarray] = ()
    """Paths to the best frontiers, best first, shape (n, 2) each, map frame [m]."""
    nearest: list[int]
    """Index of the nearest point of each path, as in `GoalPlanner`."""
    table: np.ndarray
    """Frontiers of the paths, dtype `CANDIDATE`."""

    def __init__(self, robot: RobotParams, control_period: float, rate: Rating, **limits: Any) -> None:
        """Create a planner that rates frontiers. `limits`: `max_time` and `max_candidates` of `FrontierNavigator`."""
        self._navigator, self._rate = FrontierNavigator(robot, control_period, **limits), rate
        self._reading: Reading | None = None

    def update(self, reading: Reading, belief: Belief, command: Twist, peers: Sequence[Belief] = ()) -> None:
        """Process a new reading; `command`: last velocity command; `peers`: estimates of teammates."""
        navigator = self._navigator
        if reading is self._reading:
            return
        is_first, self._reading = self._reading is None, reading
        if is_first:
            navigator.begin(reading, belief)
            self._choose(belief)
            return
        if navigator.navigator.is_recovering:
            # Recovery behaviors advance with each command, which is not executed.
            navigator.command(belief)
        navigator.navigator.note_command(command)
        for peer in peers:
            navigator.integrate(peer)
        if belief.update.redrawn and belief.update.correction is not None:
            self.paths = [belief.update.correction.apply(path) for path in self.paths]
        if navigator.update(reading, belief) is not None:
            self._choose(belief)

    def _choose(self, belief: Belief) -> None:
        navigator, candidates = self._navigator, self._navigator.candidates
        scores = np.asarray(self._rate(navigator, belief))
        if scores.shape != (len(candidates),):
            raise ValueError(f"rating of plan must return {len(candidates)} scores, got shape {scores.shape}")
        best = np.argsort(-scores, kind="stable")[: self.num_paths].tolist()
        # The frontier lies beyond the viewpoint at the path's end.
        self.paths = [np.vstack([navigator.path_to(k), candidates["frontier"][k]]) for k in best]
        self.nearest, self.table = [0] * len(best), candidates.table[best]
        if best:
            navigator.choose(best[0])
        else:
            navigator.look_around()
