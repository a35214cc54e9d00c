"""The protocols of explorers, classic or learned."""

from typing import Protocol, runtime_checkable

import numpy as np

from envs.estimation import Belief
from envs.robots import RobotParams
from envs.simulation import Reading, Twist
from envs.tasks.coverage import Coverage


class Agent(Protocol):
    """What an explorer and a policy have in common."""

    @property
    def end_reason(self) -> str | None:
        """Why the explorer has stopped exploring ("no_reachable_frontier", ...); None while it has not."""

    @property
    def plan(self) -> np.ndarray | None:
        """The planned path for drawing, shape (n, 2), map frame [m]; None without one."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode.

        Args:
            robot: the robot that will be driven.
            control_period: time between two calls of `act` [s].
            rng: source of every random draw of the episode.
        """


class Explorer(Agent, Protocol):
    """Decides, from sensor readings and the SLAM's estimates, how to drive. Metres in, metres per second out.

    Never sees ground truth. `baselines.episode.run_episode` also takes policies (`ObservationPolicy`).
    """

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist to command for the next control period; what exceeds the robot's limits is cut off.

        Args:
            reading: what the sensors say now.
            belief: pose estimate and map now.
        """


class ObservationPolicy(Agent, Protocol):
    """Chooses actions from an environment's observations, as learned policies do."""

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray | np.integer:
        """Return the action for an observation: an array, or the index of a frontier."""


@runtime_checkable
class Omniscient(Protocol):
    """An explorer that uses ground truth: no competitor, but the bound that the others are measured against."""

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        """Take the ground truth of an episode; called after `Agent.reset`.

        Args:
            coverage: what there is to explore and what is explored, kept up to date by the environment.
            target_coverage: share of the area that ends the episode.
        """


def to_action(twist: Twist, robot: RobotParams) -> np.ndarray:
    """Return the action, shape (2,), float32, that commands a twist: fractions of the robot's limits, clipped."""
    return np.clip(np.array([twist.v / robot.max_v, twist.w / robot.max_w], dtype=np.float32), -1.0, 1.0)
