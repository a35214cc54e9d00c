"""What an environment is made of besides simulation and estimation: a task and the parts of its observations."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from envs.geometry import Pose2D
from envs.measures import Measure
from envs.robot import Robot
from envs.robots import RobotParams
from envs.simulation import Reading, RobotState
from envs.worlds import World


class ObservationPart(Protocol):
    """One entry of an observation, for one robot."""

    def space(self, robot: RobotParams) -> spaces.Space:
        """Return the space of what `write` writes."""
        ...

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write what the robot senses or estimates to `out`, an array of the space's shape and dtype."""
        ...


class RewardTerms(Protocol):
    """Weights of reward terms; see `envs.tasks.rewards.Weights`."""

    def names(self) -> tuple[str, ...]:
        """Return the names of the terms."""
        ...

    def terms(self, quantities: Mapping[str, float]) -> dict[str, float]:
        """Return the terms of a step by name."""
        ...


class Task(ABC):
    """In which world an episode runs, what is rewarded, and when it ends.

    A task sees ground truth. Policies see of it only its observation parts and what it passes to estimators at the
    start.
    """

    measures: Sequence[Measure]
    """Measures of an episode, one of them the headline; `envs.measures.COMMON` and `SUCCESS` come on top."""
    progress: str
    """Entry of `info` that says how much of the task is done, from 0 to 1; curves show it over time."""
    weights: RewardTerms
    """Weights of the reward terms."""
    reset_options: tuple[str, ...] = ()
    """Keys of `reset(options=)` that the task reads, besides "world" and "start"."""
    true_robot: RobotParams | None = None
    """The robot as it is in this episode, where its parameters are drawn; None where it is the nominal one."""
    map_pose: Pose2D
    """Pose of the map frame in the world, once `reset` has been called."""
    end_reason: str | None = None
    """Why the task has ended the episode; None while it has not."""

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the observation parts that the task adds to `envs.observations.PARTS`, by name."""
        return {}

    @abstractmethod
    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        """Return the world of the next episode; called ahead of time where there is time for it.

        Args:
            world: what users passed to `reset(options={"world": ...})`; None for the one that they constructed it with.
            rng: draws from a procedural family.
        """

    @abstractmethod
    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> Sequence[Pose2D]:
        """Return where the robots start, world frame.

        Args:
            world: of the episode.
            start: what users passed to `reset(options={"start": ...})`; None for what they constructed it with.
            rng: draws what is random.
        """

    @abstractmethod
    def reset(
        self,
        robots: Sequence[Robot],
        readings: Sequence[Reading],
        rngs: Sequence[np.random.Generator],
        rng: np.random.Generator,
        options: Mapping[str, Any],
    ) -> float:
        """Start an episode: reset the robots' estimators and process the first readings.

        Args:
            robots: all robots of the episode.
            readings: the first.
            rngs: a generator for each robot's estimator.
            rng: draws what is random about the task.
            options: of `reset`, those in `reset_options`.

        Returns:
            The usual time limit of the episode [s].
        """

    @abstractmethod
    def update(self, states: Sequence[RobotState], robots: Sequence[Robot], period: float) -> None:
        """Process a control period of so many seconds: the true states, and the robots' estimates."""

    @abstractmethod
    def quantities(self) -> dict[str, float]:
        """Return what is rewarded of the last period, by the name of the reward term."""

    @abstractmethod
    def metrics(self) -> dict[str, Any]:
        """Return what `info` tells about the task after every step; `is_success` among it."""

    def final_metrics(self) -> dict[str, Any]:
        """Return what `info` tells at the end of an episode as well."""
        return {}
