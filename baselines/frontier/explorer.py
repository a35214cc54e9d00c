"""The explorer of all rules: offers candidates, drives to the one that is chosen, and asks again when it is due."""

import math
from typing import Protocol

import numpy as np

from envs.estimation import Belief
from envs.navigation import Candidates, FrontierNavigator, NavigatorParams, PlanningParams
from envs.navigation.frontier_navigator import ARRIVED, DRIVE_TIME_UP
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


class FrontierRule(Protocol):
    """Chooses a frontier. A function will do; rules with a memory, or chance, have `reset(robot, rng)`, too.

    The same rule chooses at decision level: `env.step(np.int64(rule(env.unwrapped.candidates, env.unwrapped.belief)))`
    in `ExploreFrontiers-v0`.
    """

    def __call__(self, candidates: Candidates, belief: Belief) -> int:
        """Return the index of the candidate to drive to; there is at least one."""


class RuleExplorer:
    """An `Explorer` that drives as a rule says."""

    def __init__(
        self,
        rule: FrontierRule,
        *,
        max_time: float = 4.0,
        max_candidates: int | None = None,
        planning: PlanningParams = PlanningParams(),
        params: NavigatorParams = NavigatorParams(),
    ) -> None:
        """Make an explorer; `reset` prepares it for an episode.

        Args:
            rule: chooses between candidates.
            max_time: longest drive before the rule is asked again [s]; inf commits the robot to its goal until it is
                there, the frontier is gone, or it has failed.
            max_candidates: how many frontiers the rule is offered at most, the cheapest to get to; None for all.
            planning: what is offered, and how paths are planned.
            params: how the drives go.
        """
        self.rule, self.max_time, self.max_candidates = rule, max_time, max_candidates
        self.planning, self.params = planning, params
        self.end_reason: str | None = None
        """Why no goal is left: `"no_reachable_frontier"`, or `"stuck"` if the robot could not move; None before."""
        self._navigator: FrontierNavigator | None = None
        self._offered: Candidates | None = None

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._navigator.plan if self._navigator is not None and self._has_begun else None

    @property
    def navigator(self) -> FrontierNavigator | None:
        """What finds the candidates and drives to them; None before the first `reset`."""
        return self._navigator

    @property
    def scores(self) -> np.ndarray | None:
        """Values of the last candidates, the greatest of which the rule chose, shape (k,), float64.

        None where the rule has no method `rate(candidates)`.
        """
        rate = getattr(self.rule, "rate", None)
        return rate(self._offered) if rate is not None and self._offered is not None else None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._navigator = FrontierNavigator(
            robot,
            control_period,
            max_candidates=self.max_candidates,
            max_time=self.max_time,
            planning=self.planning,
            params=self.params,
        )
        if hasattr(self.rule, "reset"):
            self.rule.reset(robot, rng)
        self._has_begun = False
        self._offered = None
        self.end_reason = None
        # Frontiers that the robot has turned away from since the last drive that came to an end.
        self._left: list[np.ndarray] = []

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist; see `Explorer`. Raises a RuntimeError before the first `reset`."""
        navigator = self._navigator
        if navigator is None:
            raise RuntimeError("call reset before act")
        if self.end_reason is not None:
            return Twist(0.0, 0.0)
        if self._has_begun:
            outcome = navigator.update(reading, belief)
        else:
            self._has_begun = True
            navigator.begin(reading, belief)
            outcome = ARRIVED if len(navigator.candidates) else None
            if outcome is None:
                navigator.look_around()
        if outcome is not None:
            if len(navigator.candidates) == 0:
                self.end_reason = navigator.end_reason
                return Twist(0.0, 0.0)
            navigator.choose(self._stick(navigator, belief, outcome))
        return navigator.command(belief)

    def choose(self, navigator: FrontierNavigator, belief: Belief) -> int:
        """Return which of a navigator's candidates to drive to; asked directly in environments of decisions."""
        self._offered = navigator.candidates
        return self.rule(navigator.candidates, belief)

    def _stick(self, navigator: FrontierNavigator, belief: Belief, outcome: str) -> int:
        """Ask the rule; during a drive a goal that the robot has turned away from is not turned to again."""
        candidates = navigator.candidates
        choice, current = self.choose(navigator, belief), candidates.chosen
        if outcome != DRIVE_TIME_UP:
            self._left.clear()
        elif current >= 0 and choice != current:
            gaps = [math.dist(candidates.frontiers[choice], left) for left in self._left]
            if min(gaps, default=math.inf) <= navigator.params.retry_radius:
                return current
            self._left.append(candidates.frontiers[current])
        return choice


def least(values: np.ndarray, candidates: Candidates) -> int:
    """Return the candidate of the least value (shape (k,)), of equal ones the first; those that failed come last."""
    return int(np.lexsort((values, candidates.failures > 0))[0])


COMMITTED = math.inf
"""`max_time` of explorers that keep to a goal."""
