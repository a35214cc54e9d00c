"""The protocols of policies, classic or learned."""

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
    """What all that drive have in common.

    Further attributes say more: `observations` (the parts of the observation that it needs, as environments take them),
    `control_hz` (how often it decides: where the environment steps more often, actions are repeated), `level`
    ("decision" if it chooses frontiers), `uses_ground_truth` (see `marked`). A method `set_goal(goal)` is given the
    goal of a task that has one, a pose in the map frame, at the start and whenever it changes, and before it
    `set_tolerances(distance, heading)` the tolerances [m, rad] of a task that may ask for a heading; `set_route(route)`
    a task's route. Of a goal whose bearing alone is given, that pose is a point in its direction.
    """

    @property
    def end_reason(self) -> str | None:
        """Why the policy has stopped ("no_reachable_frontier", ...); None while it has not."""

    @property
    def plan(self) -> np.ndarray | None:
        """The planned path for drawing, shape (n, 2), map frame [m]; None without one."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode.

        `control_period`: time between two calls of `act` [s]; `rng`: source of every random draw of the episode.
        """


class Explorer(Policy, Protocol):
    """Decides, from sensor readings and pose and map estimates, how to drive. Metres in, metres per second out.

    Never sees ground truth. `lidarnaut.baselines.episode.run_episode` also takes policies (`ObservationPolicy`).
    """

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist to command for the next control period; what exceeds the robot's limits is cut off."""


class ObservationPolicy(Policy, Protocol):
    """Chooses actions from an environment's observations, as learned policies do."""

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray | np.integer:
        """Return the action for an observation: an array, or the index of a frontier."""


@runtime_checkable
class Omniscient(Protocol):
    """An explorer that uses ground truth: no competitor, but the bound that the others are measured against."""

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        """Take the ground truth of an episode; called after `Policy.reset`.

        `coverage` is kept up to date by the environment; `target_coverage`: share of the area that ends the episode.
        """


GROUND_TRUTH = " (ground truth)"
"""End of the name of a policy that uses ground truth, in rows, curves and pages; no other name ends so."""


def marked(name: str, policy: Any, env: gymnasium.Env[Any, Any] | None = None) -> str:
    """Return the name of a policy, with `GROUND_TRUTH` if it uses some.

    It does if it is `Omniscient` or has `uses_ground_truth`, or if `env` has and it acts by observations, as None does.
    """
    uses_it = isinstance(policy, Omniscient) or getattr(policy, "uses_ground_truth", False)
    if env is not None and not hasattr(policy, "act") and env.has_wrapper_attr("uses_ground_truth"):
        uses_it = uses_it or env.get_wrapper_attr("uses_ground_truth")
    return name + GROUND_TRUTH if uses_it else name


class OnePerRobot:
    """A team in which every robot is driven by a copy of the same explorer, by itself.

    Teams have `is_team`, `plans`, a path per robot, and an `act` that takes readings and beliefs of all robots.
    """

    is_team = True
    plan = None

    def __init__(self, explorer: Explorer) -> None:
        self._explorer, self._explorers = explorer, list[Explorer]()
        self.uses_ground_truth = getattr(explorer, "uses_ground_truth", False)

    @property
    def end_reason(self) -> str | None:
        """Why the first of the explorers has stopped; None while one of them has not."""
        reasons = [explorer.end_reason for explorer in self._explorers]
        return None if None in reasons or not reasons else reasons[0]

    @property
    def plans(self) -> list[np.ndarray | None]:
        """The planned path of each robot for drawing, shape (n, 2), map frame [m]; None without one."""
        return [explorer.plan for explorer in self._explorers]

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._arguments, self._explorers = (robot, control_period, rng), []

    def act(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[Twist]:
        """Return the twists of all robots."""
        robot, period, rng = self._arguments
        if not self._explorers:
            self._explorers = [copy.deepcopy(self._explorer) for _ in readings]
            for explorer, own in zip(self._explorers, rng.spawn(len(readings)), strict=True):
                explorer.reset(robot, period, own)
        return [one.act(*seen) for one, seen in zip(self._explorers, zip(readings, beliefs), strict=True)]


def to_action(twist: Twist, robot: RobotParams) -> np.ndarray:
    """Return the action, shape (2,), float32, that commands a twist: fractions of the robot's limits, clipped."""
    return np.clip(np.array([twist.v / robot.max_v, twist.w / robot.max_w], dtype=np.float32), -1.0, 1.0)
