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
    """Interface of all policies.

    Optional attributes: `observations` (names of required observations), `control_hz` (actions per second [Hz],
    repeated in between), `level` (`"decision"` if actions are frontiers instead of velocities), `uses_ground_truth`,
    `markers` (goals and random trees that the policy considers, as `lidarnaut.envs.navigation.Markers` or None; read
    only when a picture or a recorded sample is made).

    Optional methods: `set_goal(goal)` receives the goal pose, map frame, at the start and after changes. If only the
    bearing is known, `goal` is a point in the direction of the goal. `set_tolerances(distance, heading)` receives the
    goal tolerances [m, rad] before. `set_route(route)` receives the route of a task.
    """

    @property
    def end_reason(self) -> str | None:
        """Reason why the policy stopped, such as `"no_reachable_frontier"`; None while active."""

    @property
    def plan(self) -> np.ndarray | None:
        """Planned path for rendering, shape (n, 2), map frame [m]; None without a path."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare the policy for an episode.

        `control_period`: time between actions [s]. `rng`: random generator of the policy.
        """


class Explorer(Policy, Protocol):
    """Policy that computes velocities from sensor data, estimated pose and map, without ground truth."""

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the velocity command for the next control period, which is clipped to the robot's limits.

        `reading`: sensor data. `belief`: estimated pose and map.
        """


class ObservationPolicy(Policy, Protocol):
    """Policy that computes actions from Gymnasium observations, for example a trained network."""

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray | np.integer:
        """Return the action for an observation: an array, or the index of a frontier."""


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """Policy that receives ground truth, as an upper bound for other policies."""

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        """Receive the ground truth of an episode, after `reset`.

        `coverage`: true map, start pose and explored cells. `target_coverage`: explored fraction that ends the episode.
        """


GROUND_TRUTH = " (ground truth)"


def marked(name: str, policy: Any, env: gymnasium.Env[Any, Any] | None = None) -> str:
    """Return the name of a policy, with the suffix " (ground truth)" if the policy uses ground truth.

    Ground truth in the observations of `env` also counts.
    """
    uses_it = isinstance(policy, PrivilegedPolicy) or getattr(policy, "uses_ground_truth", False)
    if env is not None and not hasattr(policy, "act") and env.has_wrapper_attr("uses_ground_truth"):
        uses_it = uses_it or env.get_wrapper_attr("uses_ground_truth")
    return name + GROUND_TRUTH if uses_it else name


class OnePerRobot:
    """Team policy that drives each robot by a separate copy of an explorer.

    Arguments and result of `act` are lists with one item per robot, as is `plans`, the planned paths.
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
    """Return a velocity command divided by the robot's limits and clipped to [-1, 1], shape (2,), float32."""
    return np.clip(np.array([twist.v / robot.max_v, twist.w / robot.max_w], dtype=np.float32), -1.0, 1.0)
