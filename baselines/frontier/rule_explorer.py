import math
from typing import Any, Protocol

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import Candidates, FrontierNavigator, Markers, NavigatorParams, PlanningParams
from lidarnaut.envs.navigation.frontiers.frontier_navigator import ARRIVED, DRIVE_TIME_UP, RETRY_RADIUS
from lidarnaut.envs.navigation.policy import Explorer
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

COMMITTED = math.inf
"""Value of `max_time` that keeps a frontier until the drive ends [s]."""


class FrontierRule(Protocol):
    """Function that scores candidates (reachable frontiers).

    A rule with state also has a method `reset(robot, rng)`. The environment `ExploreFrontiers-v0` accepts choices of a
    rule: `env.step(rule(env.unwrapped.candidates, env.unwrapped.belief).argmax())`.
    """

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        """Return a score for each candidate (reachable frontier), shape (k,), k > 0; the highest is chosen.

        `belief`: estimated pose and map.
        """


class RuleExplorer(Explorer):
    """Drives to the candidate (reachable frontier) with the highest score of a rule."""

    def __init__(
        self,
        rule: FrontierRule,
        *,
        max_time: float = 4.0,
        max_candidates: int | None = None,
        planning: PlanningParams = PlanningParams(),
        params: NavigatorParams = NavigatorParams(),
    ) -> None:
        """Create an explorer with a rule that scores frontiers.

        `max_time`: maximum drive time before the next choice of a frontier [s]. `max_candidates`: maximum number of
        frontiers to score, lowest path cost first. `planning`, `params`: parameters of planning and driving.
        """
        self.rule, self.max_time, self.max_candidates = rule, max_time, max_candidates
        self.planning, self.params = planning, params
        self.uses_ground_truth = getattr(rule, "uses_ground_truth", False)

    @property
    def _has_begun(self) -> bool:
        return self.navigator is not None and self.navigator.candidates is not None

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        return None if self.navigator is None else self.navigator.plan

    @property
    def markers(self) -> Markers | None:  # type: ignore[override]
        return Markers.of([self.navigator]) if self._has_begun else None

    @property
    def status(self) -> str:  # type: ignore[override]
        """Goal, and numbers of reachable frontiers and of blacklisted goals or failed drives, for the log."""
        if (navigator := self.navigator) is None or not self._has_begun:
            return ""
        goal = np.round(navigator.target or (), 2).tolist()
        return f"goal {goal}, {len(navigator.candidates)} frontiers, {self._count_failed(navigator)} blacklisted"

    def _count_failed(self, navigator: FrontierNavigator) -> int:
        return len(navigator.failures)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        limits: Any = {"max_candidates": self.max_candidates, "max_time": self.max_time}
        parts: Any = {"planning": self.planning, "params": self.params}
        self.navigator = FrontierNavigator(robot, control_period, **limits, **parts)
        if hasattr(self.rule, "reset"):
            self.rule.reset(robot, rng)
        self.scores = self.end_reason = None
        # Frontiers that the robot has left since the last completed drive.
        self._left: list[np.ndarray] = []

    def act(self, reading: Reading, belief: Belief) -> Twist:
        navigator = self.navigator
        if navigator is None:
            raise RuntimeError("call reset before act")
        if self.end_reason is not None:
            return Twist(0.0, 0.0)
        if self._has_begun:
            outcome = navigator.update(reading, belief)
        else:
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
        """Return the index of the candidate (reachable frontier) with the highest score."""
        self.scores = self.rate(navigator, belief)
        return int(self.scores.argmax())

    def rate(self, navigator: FrontierNavigator, belief: Belief) -> np.ndarray:
        name, count = getattr(self.rule, "__name__", type(self.rule).__name__), len(navigator.candidates)
        try:
            scores = np.asarray(self.rule(navigator.candidates, belief), dtype=np.float64)
        except Exception as error:
            raise ValueError(f"frontier rule {name}: {type(error).__name__}: {error}") from error
        if scores.shape != (count,) or np.isnan(scores).any():
            got = f"shape {scores.shape} with {np.isnan(scores).sum()} NaN"
            raise ValueError(f"frontier rule {name} must return {count} scores without NaN, got {got}")
        return scores

    def _stick(self, navigator: FrontierNavigator, belief: Belief, outcome: str) -> int:
        candidates = navigator.candidates
        choice, current = self.choose(navigator, belief), candidates.chosen
        if outcome != DRIVE_TIME_UP:
            self._left.clear()
        elif current >= 0 and choice != current:
            frontiers = candidates["frontier"]
            gaps = [math.dist(frontiers[choice], left) for left in self._left]
            if min(gaps, default=math.inf) <= RETRY_RADIUS:
                return current
            self._left.append(frontiers[current])
        return choice
