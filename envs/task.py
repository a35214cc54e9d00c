"""What an environment is made of besides simulation and estimation: a task and the parts of its observations."""

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.arguments import is_number
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.files import resolve
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.measures import TIME_TO_SUCCESS, Measure
from lidarnaut.envs.robot import Prior, Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.worlds import World


class ObservationPart(Protocol):
    """One entry of an observation, for each robot.

    A part that keeps something for an episode also has `reset(robot)`, called once the robot has processed its first
    reading.

    One with `uses_ground_truth = True` has `write(robot, out, truth)`, which gets the robot's `GroundTruth`; policies
    that observe it are marked, see `lidarnaut.baselines.explorer.marked`.
    """

    def space(self, robot: RobotParams) -> spaces.Space:
        """Return the space of what `write` writes."""
        ...

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write what the robot senses or estimates to `out`, an array of the space's shape and dtype."""
        ...


class RowPart:
    """Base of parts of the package with `write_rows(batch, out)`: writes the active rows of a `Batch`, by a kernel."""

    _memory: Sequence[Any] = ()  # names of entries of `batch.memory` that it reads
    write_rows: Callable[..., None]

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the row of one robot to `out`."""
        self.write_rows(robot._alone(self._memory), out[None])


class Rewards:
    """Terms of a reward by name, of which it is the sum: each quantity of a task that has a weight, times that weight.

    Subclasses may have further `changes` of the task's weights, and make terms of their own of its quantities.
    """

    changes: Mapping[str, float] = MappingProxyType({})
    """Weights that differ from the task's, and of terms that it does not have."""

    def __init__(self, weights: Mapping[str, float]) -> None:
        """Take the weights of a task; ValueError if one is not finite."""
        for name, weight in (chosen := {**weights, **self.changes}).items():
            if not is_number(weight):
                raise ValueError(f"reward weight {name!r} must be finite, got {weight!r}")
        self.weights = {name: float(weight) for name, weight in chosen.items()}
        """Weights by name, in the order of summation."""

    @staticmethod
    def of(weights: Mapping[str, float], reward: Any) -> "Rewards":
        """Return the terms of a task as a user wants them.

        `weights`: of the task; `reward`: None, other weights for some of them, a subclass of this class, or
        `module:attribute` of either. ValueError if there is no such term, or a weight is not finite.
        """
        reward = resolve(reward, {}, "reward")
        if isinstance(reward, type) and issubclass(reward, Rewards):
            return reward(weights)
        changes = {} if reward is None else reward
        if not isinstance(changes, Mapping):
            raise ValueError(f"reward must map {list(weights)} to weights, or be a subclass of Rewards, got {reward!r}")
        if unknown := sorted(set(changes) - set(weights)):
            raise ValueError(f"reward has unknown terms {unknown}; allowed are {list(weights)}")
        return Rewards({**weights, **changes})

    def terms(self, quantities: Mapping[str, Any]) -> dict[str, Any]:
        """Return the terms of a step by the quantities of the task, each in the unit that its weight is for."""
        return {name: weight * quantities[name] for name, weight in self.weights.items()}


def total(terms: Mapping[str, Any]) -> Any:
    """Return the sum of reward terms, numbers or columns, added in order. `sum` rounds otherwise since Python 3.12."""
    return functools.reduce(operator.add, terms.values(), 0.0)


class Task(ABC):
    """In which world an episode runs, what is rewarded, and when it ends.

    The parameters of a task's constructor are arguments of its environments, beside those that all of them share
    (`lidarnaut.envs.core.LidarEnv`); dataclasses need no constructor of their own. A task sees ground truth. Policies
    see of it only its observation parts and what it tells robots at the start (`prior`).

    A task that keeps what it knows of an episode in `Rows.memory` may have `update_rows(batch)`: it does what `update`
    does for the environments of `batch.active` at once, and returns `quantities`, `metrics`, and whether the task has
    ended the episode, as columns with an entry for each environment; see `lidarnaut.envs.tasks.reach_goal`.
    """

    measures: ClassVar[Sequence[Measure]] = (TIME_TO_SUCCESS,)
    """Measures of an episode, one of them the headline; `lidarnaut.envs.measures.COMMON` and `SUCCESS` come on top."""
    progress: ClassVar[str] = "is_success"
    """Entry of `info` that says how much of the task is done, from 0 to 1; curves show it over time."""
    reset_options: ClassVar[tuple[str, ...]] = ()
    """Keys of `reset(options=)` that the task reads, besides "world" and "start"."""
    num_robots: int = 1
    """How many robots there are."""
    is_team: ClassVar[bool] = False
    """Whether actions and observations have an axis for the robots."""
    rests_between_scans: bool = False
    """Whether periods in which no robot integrates a scan change nothing but time and contact: `quantities` has the
    seconds that all passed as "time", those in contact as "collision", and zeros; `metrics` stays. Kernels pass over
    such periods of many environments, or of a decision, without `update`."""
    arrays: tuple[np.ndarray, ...] = ()
    """What a task with `update_rows` needs of its episode, besides rows of memory; of a `Batch` they are
    `task_arrays`."""
    uses_true_motion: bool = False
    """Whether estimators get the true motion in place of odometry's."""
    sampler_ahead: Any = None
    """Sampler of worlds if `draw_world` depends on it and the generator alone, and calls no code of users. A thread may
    call `draw_world` ahead of time then. None otherwise."""
    weights: Mapping[str, float]
    """Weights of the reward terms by name, each of which is one of the `quantities`."""
    reward: Any = None
    """What the user wants to be rewarded otherwise; see `Rewards.of`."""
    rewards: Rewards
    """The terms of both."""
    robot: RobotParams
    """The nominal robot."""
    control_period: float
    """Time between two steps [s]."""
    physics: str
    """Name of the physics."""
    starts: Sequence[Pose2D]
    """Where the robots started, world frame; set by `choose_starts`."""
    map_pose: Pose2D
    """Pose of the map frame in the world; set by `choose_starts` where it depends on them."""
    end_reason: str | None = None
    """Why the task has ended the episode; None while it has not."""

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        """Take note of what the environment is made of; called once, before all else.

        Raises:
            ValueError: the task cannot be done with that; the message names the culprit.
        """
        self.robot, self.control_period, self.physics = robot, control_period, physics
        if not hasattr(self, "weights"):
            raise ValueError(f"task {type(self).__name__} needs weights of reward terms, such as {{'time': -0.02}}")
        self.rewards = Rewards.of(self.weights, self.reward)

    def default_observations(self) -> Sequence[str]:
        """Return the names of the observation parts that are shown by default: the task's own among them."""
        return ("scan", "map_near", "map_far", "motion", *self.observation_parts())

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the observation parts that the task adds to `lidarnaut.envs.observations.PARTS`, by name."""
        return {}

    @abstractmethod
    def make_estimator(self) -> Estimator:
        """Return what estimates the pose of a robot and its map; called once for each robot."""

    @abstractmethod
    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        """Return the world of the next episode; called ahead of time if there is a `sampler_ahead`.

        `world` is what users passed to `reset(options={"world": ...})`, None for the one that they constructed it with.
        """

    def place(self, world: World, start: Any) -> World:
        """Return the part of a world for the episode; `start` as for `choose_starts`."""
        return world

    @abstractmethod
    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> Sequence[Pose2D]:
        """Return where the robots start, world frame, and set `starts` and `map_pose`; `start` as for `draw_world`."""

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        """Return what a robot is told at the start: its own pose, and no map; called after `choose_starts`.

        `index` says which robot, and `rng` is that of its estimator.
        """
        return Prior(self.map_pose.between(self.starts[index]))

    @abstractmethod
    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode, once the robots have processed their first readings; return its usual time limit [s].

        `simulator`: ground truth: states of the robots, contacts, what moves; `robots`: all of the episode, with their
        estimates; `rng`: draws what is random about the task; `options`: of the environment's `reset`, those in
        `reset_options`.
        """

    @abstractmethod
    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Process a control period of so many seconds; `simulator` and `robots` as for `reset`."""

    @abstractmethod
    def quantities(self) -> dict[str, float]:
        """Return what is rewarded of the last period, by the name of the reward term."""

    @abstractmethod
    def metrics(self) -> dict[str, Any]:
        """Return what `info` tells about the task after every step; `is_success` among it."""

    def final_metrics(self) -> dict[str, Any]:
        """Return what `info` tells at the end of an episode as well."""
        return {}
