"""Interfaces of classical and learned policies."""

import copy
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation.policy import Explorer, Policy, wrap
from lidarnaut.envs.navigation.policy import Level as Level
from lidarnaut.envs.navigation.policy import ObservationPolicy as ObservationPolicy
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist
from lidarnaut.envs.tasks.coverage import Coverage


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """Policy that receives ground truth, as an upper bound for other policies."""

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        """Receive the ground truth of an episode, after `reset`.

        `coverage`: true map, start pose and explored cells. `target_coverage`: explored fraction that ends the episode.
        """


GROUND_TRUTH = " (ground truth)"


def marked(name: str, policy: Policy | None, env: gymnasium.Env[Any, Any] | None = None) -> str:
    """Return the name of a policy, with the suffix " (ground truth)" if the policy uses ground truth.

    Ground truth in the observations of `env` also counts. `policy`: None for one that uses its observations only.
    """
    uses_it = isinstance(policy, PrivilegedPolicy) or (policy is not None and policy.uses_ground_truth)
    if env is not None and not isinstance(policy, Explorer) and env.has_wrapper_attr("uses_ground_truth"):
        uses_it = uses_it or env.get_wrapper_attr("uses_ground_truth")
    return name + GROUND_TRUTH if uses_it else name


class OnePerRobot(Explorer):
    """Team policy that drives each robot by a separate copy of an explorer.

    Arguments and result of `act` are lists with one item per robot, as is `plans`, the planned paths.
    """

    is_team = True

    def __init__(self, explorer: Explorer) -> None:
        self._explorer, self._explorers = wrap(explorer, Explorer), list[Explorer]()
        self.uses_ground_truth = self._explorer.uses_ground_truth

    @property
    def end_reason(self) -> str | None:  # type: ignore[override]
        reasons = [explorer.end_reason for explorer in self._explorers]
        return None if None in reasons or not reasons else reasons[0]

    @property
    def plans(self) -> list[np.ndarray | None]:
        return [explorer.plan for explorer in self._explorers]

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._explorers = []

    def act(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[Twist]:  # type: ignore[override]
        if not self._explorers:
            self._explorers = [copy.deepcopy(self._explorer) for _ in readings]
            for explorer, own in zip(self._explorers, self.rng.spawn(len(readings)), strict=True):
                explorer.reset(self.robot, self.control_period, own)
        return [one.act(*seen) for one, seen in zip(self._explorers, zip(readings, beliefs), strict=True)]


def to_action(twist: Twist, robot: RobotParams) -> np.ndarray:
    """Return a velocity command divided by the robot's limits and clipped to [-1, 1], shape (2,), float32."""
    return np.clip(np.array([twist.v / robot.max_v, twist.w / robot.max_w], dtype=np.float32), -1.0, 1.0)
