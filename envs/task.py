"""Interfaces of tasks, reward functions and observation parts (entries of the observation)."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import FunctionType, MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.arguments import is_number
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.files import SHORT, explain_unknown, resolve
from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.measures import TIME_TO_SUCCESS, Measure
from lidarnaut.envs.robot import MAX_PERSON_GAP, Prior, Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.transition import pose_errors
from lidarnaut.envs.worlds import World

COLUMNS = {"forward_speed": "v", "yaw_rate": "w"}
COLUMNS |= {name: name for name in ("action_v", "action_w", "acceleration", "jerk", "person_gap")}
SHARED_QUANTITIES = (*COLUMNS, "obstacle_gap", "position_error", "yaw_error")
"""Quantities of all tasks, see `Rewards`. `COLUMNS`: fields of some in a robot's record."""
DEFAULT_TIME_LIMIT = 300.0
NOWHERE = World("unknown", np.empty((0, 4)), np.empty((0, 3)), (ORIGIN,), (0.0, 0.0, 0.0, 0.0))
"""World without walls, in the place of an unknown one."""


class ObservationPart(Protocol):
    """Entry of the observation dictionary of a robot.

    A part that keeps state has `reset(robot)`, called after the robot's first scan in an episode. A part with
    `uses_ground_truth = True` has `write(robot, out, truth)`, with a `GroundTruth`; policies that observe it get a
    suffix in reports, see `lidarnaut.baselines.policy.marked`.
    """

    def space(self, robot: RobotParams) -> spaces.Space:
        """Return the Gymnasium space of this observation entry for a robot."""
        ...

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write this observation entry to the array `out` of its space, from readings or estimates of the robot."""
        ...


class BoxPart:
    """Base of built-in observation parts with `size` numbers from `low` to 1."""

    low: float = -1.0
    size: int

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(self.low, 1.0, (self.size,), np.float32)


class RowPart(BoxPart):
    """Base of parts of the package that write the observation entry of many robots in a single call.

    Subclasses define `_write(rows, out)` for the active robots of `RobotRows`, which contain ground truth.
    """

    uses_ground_truth: bool = False
    _write: Callable[..., None]

    def write(self, rows: Any, out: np.ndarray, truth: Any = None) -> None:
        """Write the entries of `RobotRows` to `out`, shape (n, ...).

        A user's part that contains or extends this one may instead pass a `Robot`, with its `truth` if the part uses
        it, and an array of the space.
        """
        if isinstance(rows, Robot):
            if self.uses_ground_truth and truth is None:
                raise TypeError(f"{type(self).__name__} shows ground truth: call write(robot, out, truth)")
            rows, out = rows.as_rows(truth), out[None]
        self._write(rows, out)


class Rewards:
    """Reward function: sum of quantities of a step, each times the weight of the same name.

    Subclasses may override `changes`, `terms` and `per_step`. The class of a task lists its own quantities, such as
    `progress`. All tasks share the following, true values at the end of the step, without a weight by default:

    - `forward_speed`: forward speed, negative backwards [m/s].
    - `yaw_rate`: yaw rate, counter-clockwise [rad/s].
    - `action_v`, `action_w`: forward speed and yaw rate of the action, as fractions of the limits [1].
    - `acceleration`: change of the forward speed set by the speed controller [m/s2].
    - `jerk`: magnitude of the change of the acceleration [m/s3].
    - `person_gap`: gap between footprint and nearest person, at most 10 m [m].
    - `obstacle_gap`: gap between footprint and nearest static obstacle or other robot, at most 10 m [m].
    - `position_error`: distance between estimated and true position [m].
    - `yaw_error`: magnitude of the heading error of the pose estimate [rad].

    Their terms are weight x duration [s] x magnitude; `forward_speed` keeps its sign. In a team, they are arrays, shape
    (num_robots,), float64, and terms are sums over the robots.
    """

    changes: Mapping[str, float] = MappingProxyType({})
    """Weights by term name that replace weights of the task or add terms."""
    per_step: Sequence[str] = ()
    """Own terms that are amounts of a step. All others are rates per second, multiplied by the duration of the step."""

    def __init__(self, weights: Mapping[str, float], changes: Mapping[str, float] | None = None) -> None:
        """Create the reward function of a task with default `weights`; `changes` replaces the attribute."""
        changes, has_own_terms = self.changes if changes is None else changes, type(self).terms is not Rewards.terms
        if not has_own_terms and (unknown := sorted(changes.keys() - weights.keys() - {*SHARED_QUANTITIES})):
            raise ValueError(f"reward has unknown terms {unknown}; allowed are {[*weights, *SHARED_QUANTITIES]}")
        for name, weight in (chosen := {**weights, **changes}).items():
            if not is_number(weight):
                raise ValueError(f"reward weight {name!r} must be finite, got {weight!r}")
        self.weights = {name: float(weight) for name, weight in chosen.items()}
        self.shared = [name for name in SHARED_QUANTITIES if name in chosen]
        """Weighted quantities that all tasks share."""
        self.has_own_terms, self.reads_shared = has_own_terms, has_own_terms or len(self.shared) > 0

    @staticmethod
    def of(weights: Mapping[str, float], reward: Any) -> "Rewards":
        """Create the reward function of a task from default weights and the argument `reward`.

        `reward` is None, a mapping of weights to replace, a subclass of `Rewards`, or `module:attribute` of either. The
        key `class` of a mapping names a subclass, whose weights the others replace.

        Raises:
            ValueError: if a term is unknown, or a weight is not finite.
        """
        found = {} if reward is None else resolve(reward, {}, "reward")
        changes = dict(found) if isinstance(found, Mapping) else {"class": found}
        kind = resolve(changes.pop("class", Rewards), {}, "reward")
        if not (isinstance(kind, type) and issubclass(kind, Rewards)):
            raise ValueError(f"reward must map {list(weights)} to weights, or be a subclass of Rewards, got {reward!r}")
        return kind(weights, {**kind.changes, **changes}) if changes else kind(weights)

    def step_terms(self, quantities: Mapping[str, Any]) -> dict[str, Any]:
        """Return `terms`, those of the subclass (except `per_step`) multiplied by the duration of the step."""
        if not self.has_own_terms:
            return self.terms(quantities)
        known, terms = {*quantities, *SHARED_QUANTITIES, *self.per_step}, self.terms(quantities)
        own = terms if isinstance(terms, Mapping) else {}
        rates = [name for name, term in own.items() if name not in known and is_number(term)]
        return {**own, **{name: own[name] * quantities["time"] for name in rates}} if rates else terms

    def terms(self, quantities: Mapping[str, Any]) -> dict[str, Any]:
        """Return the reward terms of a step by name; raise ValueError for a weight without a quantity."""
        try:
            terms = {name: weight * quantities[name] for name, weight in self.weights.items()}
        except KeyError as error:
            raise ValueError(f"reward has no quantity {explain_unknown(error.args[0], quantities)}") from None
        for name in self.shared:
            terms[name] = self.weights[name] * quantities["time"] * magnitude(name, quantities[name])
        return terms

    def checked_total(self, terms: Any) -> Any:
        """Return the sum of terms; raise ValueError if one is not a finite number."""
        try:
            if (type(value := total(terms)) is float and abs(value) < np.inf) or is_number(value):
                return value
        except (TypeError, ValueError, AttributeError):
            pass
        if isinstance(terms, Mapping):
            terms = {name: term for name, term in terms.items() if not is_number(term)}
        raise ValueError(f"reward {type(self).__name__} must return finite numbers by name, got {SHORT.repr(terms)}")


class Quantities(dict[str, Any]):
    """Quantities of a step: those of the task, and shared ones (see `Rewards`), computed when first read by name."""

    def __init__(self, own: Mapping[str, Any], env: Any) -> None:
        """Begin with the task's quantities `own`, and shared ones with a weight. `env`: `LidarEnv` after a step."""
        super().__init__(own)
        self._env = env
        self.update({name: self[name] for name in env.task.rewards.shared})

    def __missing__(self, name: str) -> Any:
        rows, world = self._env.rows.numbers, self._env.world
        if name in COLUMNS:
            values = rows[COLUMNS[name]].copy()
        elif name == "obstacle_gap":
            bodies = np.stack([rows["x"], rows["y"], rows["radius"]], axis=1)
            values = np.empty(len(rows))
            for k, (x, y, radius) in enumerate(bodies.tolist()):
                circles = np.ascontiguousarray(np.vstack([world.circles, np.delete(bodies, k, axis=0)]))
                values[k] = min(max(clearance(x, y, world.segments, circles) - radius, 0.0), MAX_PERSON_GAP)
        elif name in SHARED_QUANTITIES:
            values = pose_errors(rows)[:, int(name == "yaw_error")]
        else:
            raise ValueError(f"unknown quantity {explain_unknown(name, dict.fromkeys([*self, *SHARED_QUANTITIES]))}")
        self[name] = values if self._env.task.is_team else float(values[0])
        return self[name]


def magnitude(name: str, value: Any) -> float:
    """Return a shared quantity as its term has it: absolute, except for `forward_speed`, and summed over the robots."""
    return float(np.sum(value if name == "forward_speed" else np.abs(value)))


def total(terms: Mapping[str, Any]) -> Any:
    """Return the sum of reward terms, added in order, without the extra precision of Python's `sum`."""
    value: Any = 0.0
    for term in terms.values():
        value = value + term
    return value


class Brief(ABC):
    """Part of a task that a real robot has too: estimators, observation parts, goal, initial pose and map.

    A brief alone is the task of a real robot, see `lidarnaut.Driver`: its world is unknown, without
    reward and end. Subclasses that are no `Task` define the members that need no ground truth; their parameters are
    also arguments of the driver.
    """

    progress: ClassVar[str] = "is_success"
    """Key in `info` of the completed fraction of the task, in [0, 1]."""
    reset_options: ClassVar[tuple[str, ...]] = ()
    """Keys of `reset(options=...)` that the task accepts, besides "world" and "start"."""
    num_robots: int = 1
    is_team: ClassVar[bool] = False
    """Whether actions and observations have a leading axis for robots."""
    uses_true_motion: bool = False
    """Whether estimators receive the true motion instead of odometry."""
    map_resolution: float = 0.05
    """Side of a map cell [m]."""
    robot: RobotParams
    """Nominal robot parameters."""
    control_period: float
    """Duration of a control period [s]."""
    physics: str
    """Physics engine: "bullet" or "kinematic"."""
    simulator: Simulator
    """Ground truth: robot states, contacts and people."""
    robots: Sequence[Robot]
    """All robots, with their readings and estimates."""
    starts: Sequence[Pose2D] = (ORIGIN,)
    """Start poses of the robots, world frame."""
    map_pose: Pose2D = ORIGIN
    """Pose of the map frame in the world frame [m, rad]."""
    options: Mapping[str, Any] = MappingProxyType({})
    """Entries of `reset(options=...)` named in `reset_options`, for this episode."""
    lasting_options: Mapping[str, Any] = MappingProxyType({})
    """Options of `LidarEnv.set_options`, for all further episodes."""
    rewards: Rewards = Rewards({})
    """Reward function of the episode."""
    end_reason: str | None = None
    """Reason why the task has ended the episode, or None. The reset of an environment clears the attribute."""
    coverage: Any = None
    """Explored part of the world, `lidarnaut.envs.tasks.coverage.Coverage`; None for tasks without exploration."""
    goal: Any = None
    """Goal pose, map frame; None for tasks without a goal."""
    heading_tolerance: float | None = None
    """Heading tolerance of the current goal [rad], pi for any heading; None for tasks without a goal."""
    route: Any = None
    """Route to follow, `lidarnaut.envs.tasks.route.Route`; None for tasks without a route."""
    return_home: bool = False
    """Whether the robot has to return to its start."""
    sampler_ahead: Any = None
    """World sampler, if another thread may draw worlds in advance; otherwise None.

    `draw_world` must then use only this sampler and the generator, and call no user code."""

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        """Store robot, control period [s] and physics; called once, before all other methods.

        Raises:
            ValueError: if the task does not support them.
        """
        self.robot, self.control_period, self.physics = robot, control_period, physics

    def default_observations(self) -> Sequence[str]:
        """Return the names of the default observation parts (entries of the observation)."""
        return ("scan", "map_near", "map_far", "motion", *self.observation_parts())

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the observation parts that the task adds, by name."""
        return {}

    @abstractmethod
    def make_estimator(self) -> Estimator:
        """Return a new estimator of pose and map; called once per robot."""

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        """Return the initial pose and map for the estimator of robot `index`; by default the start pose and no map.

        `rng` is the estimator's generator.
        """
        return Prior(self.map_pose.between(self.starts[index]))

    def tell_goal(self, pose: Pose2D) -> Any:
        """Return the goal that a policy at the estimated `pose` receives, or None."""
        return self.goal

    def set_goal(self, goal: Sequence[float]) -> float:
        """Set the next goal, and return a time limit for it [s]; see `LidarEnv.set_goal`. ValueError without a goal."""
        raise ValueError(f"task {type(self).__name__} does not support set_goal")

    def set_initial_pose(self, pose: Any) -> None:
        """Restart localization; see `LidarEnv.set_initial_pose`. ValueError without AMCL."""
        raise ValueError(f"task {type(self).__name__} does not support set_initial_pose")

    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        """Return the world of the next episode.

        `world` is the value of `reset(options={"world": ...})`; None selects the world of the constructor.
        """
        return NOWHERE

    def place(self, world: World, start: Any) -> World:
        """Return the world to simulate for a given start: `world` or a part of it."""
        return world

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> Sequence[Pose2D]:
        """Return the start poses, world frame, and set `starts` and `map_pose`.

        `start` is the value of `reset(options={"start": ...})`, or None.
        """
        return self.starts

    def begin(self, simulator: Simulator, robots: Sequence[Robot]) -> None:
        """Store simulator and robots, and clear `end_reason`; called before each `reset`."""
        self.simulator, self.robots = simulator, robots
        vars(self).pop("end_reason", None)

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode after the robots have processed their first sensor readings.

        Args:
            simulator: as the attribute `simulator`.
            robots: as the attribute `robots`.
            rng: generator of the task.
            options: as the attribute `options`.

        Returns:
            Default time limit of the episode [s]; None for 300 s.
        """
        return math.inf

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:  # noqa: B027
        """Update the task after a control period of `period` seconds; other arguments as for `reset`."""

    def quantities(self) -> dict[str, float]:
        """Return rewarded quantities of the last control period by reward term, in addition to `time` and `collision`.

        Called once in each control period, after `update`, and before `end_reason`, observations and `metrics` are
        read.
        """
        return {}

    def metrics(self) -> dict[str, Any]:
        """Return the task's entries of `info`, including `is_success`: by default, whether the task has ended."""
        return {"is_success": self.end_reason is not None}

    def final_metrics(self) -> dict[str, Any]:
        """Return further entries of the last `info` of an episode."""
        return {}


class Task(Brief):
    """Base of tasks, which define worlds, start poses, reward and end of episodes, in addition to their `Brief`.

    Subclasses define `weights`, and usually the methods `reset`, `quantities` and `end_reason`, which may also be a
    property or an attribute. Other members have defaults, except worlds, starts and the estimator. Constructor
    parameters become arguments of the environments. A task has access to ground truth. Policies only see its
    observation parts and `prior`.

    For fast vector environments, a task may keep its state in the arrays `Rows.memory` and define `update_rows(batch)`:
    `update` for all environments of `batch.active`. It returns `quantities`, `metrics` and whether the episode has
    ended, as arrays with one entry per environment; see `lidarnaut.envs.tasks.reach_goal`.
    """

    measures: ClassVar[Sequence[Measure]] = (TIME_TO_SUCCESS,)
    """Measures of an episode, in addition to `lidarnaut.envs.measures.COMMON` and `SUCCESS`."""
    success_condition: str = "the task is completed"
    """Condition of `is_success` in words, for reports."""
    rests_between_scans: bool = False
    """Whether `update` may be skipped in control periods without a processed scan.

    A skipped period only adds its duration to the rewarded quantity "time" and, in contact, to "collision"."""
    arrays: tuple[np.ndarray, ...] = ()
    """Arrays of the task for Numba kernels, available to `update_rows` as `batch.task_arrays`."""
    weights: Mapping[str, float]
    """Weights of the reward terms, by the name of a quantity."""
    reward: Any = None
    """Reward weights or subclass of `Rewards` chosen by the user; see `Rewards.of`."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if isinstance(reason := vars(cls).get("end_reason"), FunctionType):  # a bound method would end each episode
            cls.end_reason = property(reason)  # type: ignore[assignment]

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        super().attach(robot, control_period, physics)
        if not hasattr(self, "weights"):
            raise ValueError(f"task {type(self).__name__} must define reward weights, such as {{'time': -0.02}}")
        self.rewards = Rewards.of(self.weights, self.reward)

    @abstractmethod
    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        pass

    @abstractmethod
    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> Sequence[Pose2D]:
        pass

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode; see `Brief.reset`. By default, of 300 s."""
        return DEFAULT_TIME_LIMIT
