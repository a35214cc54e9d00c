"""Interfaces of classical and learned policies."""

import copy
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist
from lidarnaut.envs.tasks.coverage import Coverage


class Policy(Protocol):
    """Common interface of all policies.

    Optional attributes: `observations` (required observation parts), `control_hz` (decision rate; actions are repeated
    in between), `level` ("decision" for policies that choose frontiers), `uses_ground_truth` (see `marked`).

    Optional methods: `set_goal(goal)` receives the goal pose, map frame, at the start and after changes, or a point in
    its direction if only the bearing is known. `set_tolerances(distance, heading)` is called before [m, rad].
    `set_route(route)` receives the route of a task.
    """

    @property
    def end_reason(self) -> str | None:
        """Reason why the policy has stopped ("no_reachable_frontier", ...); None before."""

    @property
    def plan(self) -> np.ndarray | None:
        """Planned path for rendering, map frame [m], shape (n, 2), or None."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for an episode.

        `control_period` is the time between calls of `act` [s], `rng` the generator of the policy.
        """


class Explorer(Policy, Protocol):
    """Policy that computes twists from readings, pose estimate and map, without ground truth."""

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist for the next control period; it is clipped to the robot's limits."""


class ObservationPolicy(Policy, Protocol):
    """Policy that computes actions from observations, for example a learned policy."""

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray | np.integer:
        """Return the action for an observation: an array, or the index of a frontier."""


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """Explorer with ground truth, an upper bound for other explorers."""

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        """Receive the ground truth of an episode, after `Policy.reset`.

        `target_coverage`: explored fraction that ends the episode.
        """


GROUND_TRUTH = " (ground truth)"
"""Suffix of the names of policies that use ground truth."""


def marked(name: str, policy: Any, env: gymnasium.Env[Any, Any] | None = None) -> str:
    """Return the name of a policy, with the suffix `GROUND_TRUTH` if it uses ground truth.

    This includes observation policies if `env` has `uses_ground_truth`.
    """
    uses_it = isinstance(policy, PrivilegedPolicy) or getattr(policy, "uses_ground_truth", False)
    if env is not None and not hasattr(policy, "act") and env.has_wrapper_attr("uses_ground_truth"):
        uses_it = uses_it or env.get_wrapper_attr("uses_ground_truth")
    return name + GROUND_TRUTH if uses_it else name


class OnePerRobot:
    """Team that drives each robot by its own copy of an explorer.

    Teams have `is_team`, `plans` (one path per robot), and an `act` with lists of readings and beliefs.
    """

    is_team = True
    plan = None

    def __init__(self, explorer: Explorer) -> None:
        self._explorer, self._explorers = explorer, list[Explorer]()
        self.uses_ground_truth = getattr(explorer, "uses_ground_truth", False)

    @property
    def end_reason(self) -> str | None:
        reasons = [explorer.end_reason for explorer in self._explorers]
        return None if None in reasons or not reasons else reasons[0]

    @property
    def plans(self) -> list[np.ndarray | None]:
        return [explorer.plan for explorer in self._explorers]

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._arguments, self._explorers = (robot, control_period, rng), []

    def act(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[Twist]:
        robot, period, rng = self._arguments
        if not self._explorers:
            self._explorers = [copy.deepcopy(self._explorer) for _ in readings]
            for explorer, own in zip(self._explorers, rng.spawn(len(readings)), strict=True):
                explorer.reset(robot, period, own)
        return [one.act(*seen) for one, seen in zip(self._explorers, zip(readings, beliefs), strict=True)]


def to_action(twist: Twist, robot: RobotParams) -> np.ndarray:
    """Return the action of a twist, shape (2,), float32: fractions of the robot's limits, clipped."""
    return np.clip(np.array([twist.v / robot.max_v, twist.w / robot.max_w], dtype=np.float32), -1.0, 1.0)
