"""Gymnasium environment of lidar robots, shared by all tasks."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from lidarnaut.envs.arguments import (
    check_positive,
    check_render_mode,
    check_time_limit,
    choose_robot,
    read_fractions,
    read_options,
)
from lidarnaut.envs.episode_worlds import EpisodeWorlds
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.files import explain_unknown, resolve
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.measures import PEOPLE
from lidarnaut.envs.navigation.controllers.collision_monitor import CollisionMonitor
from lidarnaut.envs.observations import Observations, Tracks, make_parts, reset_parts, write_entries
from lidarnaut.envs.period import TIME_TOLERANCE, Period, robots_info, why_not_fused
from lidarnaut.envs.randomization import Randomization, Ranges
from lidarnaut.envs.rendering.overlay import Overlay
from lidarnaut.envs.rendering.scene import Scene, scene_of
from lidarnaut.envs.robot import GroundTruth, Robot, reset_robots, start_tracking
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.sensor import Measured, make_sensors, reset_sensors
from lidarnaut.envs.simulation import Mover, Reading, Twist, make_simulator
from lidarnaut.envs.simulation.crowd.crowd_params import PeopleLike, crowd_of
from lidarnaut.envs.simulation.rows import Rows
from lidarnaut.envs.task import DEFAULT_TIME_LIMIT, Brief, Quantities
from lidarnaut.envs.transition import people_metrics


class LidarEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Lidar robots in a planar world, driven by velocity commands.

    One step is one control period. Actions are forward speed and yaw rate (counter-clockwise), as fractions of the
    robot's limits. A `lidarnaut.envs.task.Task` defines goal, reward and episode end.

    ## Arguments
    The arguments of the task, and:

    - `robot` (`None`): library robot, path of a robot YAML, or `RobotParams`; `None` selects the world's default.
    - `physics` (`"bullet"`): `"bullet"` (PyBullet), `"kinematic"`, the default of vector environments, or a subclass of
      `Simulator`.
    - `control_hz` (`10.0`): steps per second.
    - `time_limit` (`None`): maximum duration of an episode [s]; `None` selects the task's default.
    - `observations` (`None`): parts of the observation, see `lidarnaut.envs.observations.make_parts`; `None` selects
      the task's default.
    - `people` (`None`): number of pedestrians, (low, high), name of a crowd (`"sparse"`, `"dense"`, `"corridor"`,
      `"doorway"`, `"crossing"`), `lidarnaut.envs.simulation.Crowd`, or mapping of its parameters; sampled in each
      episode. The last `info` then contains `lidarnaut.envs.measures.PEOPLE`.
    - `track_people` (`None`): whether robots track people in scans (`belief.people`) and exclude them from maps; `None`
      enables tracking if `people` is given and the estimator is not dead reckoning.
    - `sensors` (`()`): custom sensors, see `lidarnaut.envs.sensor.Sensor`.
    - `randomize` (`None`): ranges (low, high) by robot parameter; each episode samples the simulated robot,
      see docs/guides/training.md.
    - `clip_actions` (`False`): whether actions outside [-1, 1] are clipped instead of raising an error.
    - `collision_monitor` (`False`): whether commands are slowed down to stop before obstacles in the scan, see
      `lidarnaut.envs.navigation.controllers.collision_monitor`.
    - `render_mode` (`None`): `"human"` or `"rgb_array"`.
    - `fixed_info` (`False`): whether `info` has the same keys in every step, as Minari's
      `DataCollector(record_infos=True)` requires; entries of the last step are 0, empty or `False` before.
    - `cost` (`False`): whether `info` has a `cost`: 1 for a robot in contact, plus 1 less than 0.45 m from a person.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}
    uses_ground_truth: bool = False
    """Whether observations contain ground truth; subclasses may set it."""

    def __init__(
        self,
        task: Any,
        *,
        robot: str | RobotParams | None = None,
        physics: str | type[Mover] = "bullet",
        control_hz: float = 10.0,
        time_limit: float | None = None,
        observations: Observations | None = None,
        people: PeopleLike = None,
        track_people: bool | None = None,
        sensors: Sequence[Any] = (),
        randomize: Ranges | None = None,
        clip_actions: bool = False,
        collision_monitor: bool = False,
        render_mode: str | None = None,
        fixed_info: bool = False,
        cost: bool = False,
        **settings: Any,
    ) -> None:
        """Create an environment.

        `task`: subclass of `lidarnaut.envs.task.Task`, or `module:attribute` of one. `settings`: its arguments.

        Raises:
            ValueError: if the value of an argument is not allowed.
            TypeError: if the task has no such argument.
        """
        check_render_mode(render_mode, self.metadata["render_modes"])
        check_positive(control_hz=control_hz)
        check_time_limit(time_limit)
        self.task = make_task(task, settings)
        self.robot_params = choose_robot(robot, getattr(self.task, "world", ""))
        """Nominal robot parameters; randomization changes only the simulated robot."""
        self.control_period = period = 1.0 / control_hz
        self.task.attach(self.robot_params, period, physics if isinstance(physics, str) else physics.__name__)
        num_robots = self.task.num_robots
        self.simulator: Any = make_simulator(physics, self.robot_params, period, num_robots, crowd_of(people))
        estimators, by_truth = [self.task.make_estimator() for _ in range(num_robots)], self.task.uses_true_motion
        self.robots = [Robot(self.robot_params, period, each, uses_true_motion=by_truth) for each in estimators]
        self.randomization = Randomization(randomize, self.robot_params, self.simulator) if randomize else None
        self.time_limit = time_limit or math.inf
        """Maximum duration of the episode [s]."""
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(control_hz))}
        self.overlay = Overlay(num_robots)
        self.on_period: Callable[[Sequence[Twist] | None], None] | None = None
        """Callback of recorders: None after a reset, the commanded twists after each control period."""
        self._time_limit, self.clip_actions = time_limit, clip_actions
        self.sensors = make_sensors(sensors)
        self._make_parts(observations, people, track_people)
        self._worlds, self.has_begun = EpisodeWorlds(self.task), False
        self._blank, self.fixed_info = dict[str, Any](), fixed_info
        self.period = Period(self, CollisionMonitor(self.robot_params, period) if collision_monitor else None, cost)

    def _make_parts(self, observations: Observations | None, people: PeopleLike, track_people: bool | None) -> None:
        task, shape = self.task, (self.task.num_robots, 2) if self.task.is_team else (2,)
        measured = {sensor.name: partial(Measured, sensor) for sensor in self.sensors}
        chosen = task.default_observations() if observations is None else observations
        self.parts = make_parts(chosen, {**measured, **task.observation_parts()})
        space: Any = spaces.Dict({name: part.space(self.robot_params) for name, part in self.parts.items()})
        self.observation_space: Any = batch_space(space, task.num_robots) if task.is_team else space
        self.action_space = spaces.Box(-1.0, 1.0, shape, np.float32)
        self.uses_ground_truth |= any(getattr(part, "uses_ground_truth", False) for part in self.parts.values())
        if people is not None:
            task.measures = (*task.measures, *PEOPLE)
        track_people = any(isinstance(part, Tracks) for part in self.parts.values()) or track_people
        start_tracking(self.robots, self.simulator.crowd.params is not None, track_people)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode and return the first observation and info.

        Args:
            seed: seed of all random numbers.
            options: `world`, `start` and `reset_options` of the task for this episode, as in the constructor.

        Raises:
            ValueError: if an option is unknown or has a value that is not allowed.
        """
        self.begin(seed=seed, options=options)
        return self.observe(), self.info(dict.fromkeys(self.task.rewards.weights, 0.0))

    def begin(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start an episode as `reset` does, without computing observation and info."""
        task, num_robots = self.task, len(self.robots)
        options = {**task.lasting_options, **read_options(options, ("world", "start", *task.reset_options))}
        super().reset(seed=seed)
        self.has_begun = False
        task.options = {key: options[key] for key in task.reset_options if key in options}
        self.world = task.place(self._worlds.next(options.get("world"), self.np_random), options.get("start"))
        starts = task.choose_starts(self.world, options.get("start"), self.np_random)
        rngs = self.np_random.spawn(2 * num_robots)
        # Spawned last: randomization, sensors and people do not change other parts of the episode.
        if self.randomization is not None:
            self.simulator.set_robot(self.randomization.draw(self.np_random.spawn(1)[0]))
        sensor_rngs = self.np_random.spawn(len(self.sensors))
        crowd_rng = self.np_random.spawn(1)[0] if self.simulator.crowd.params else None
        readings = self.simulator.reset(self.world, starts, rngs[::2], crowd_rng)
        self.truths = [GroundTruth(self.rows, k) for k in range(num_robots)]
        self.period.begin()
        readings = reset_sensors(self.sensors, self.simulator, self.world, sensor_rngs, readings)
        priors = [task.prior(k, rng) for k, rng in enumerate(rngs[1::2])]
        reset_robots(self.robots, self.rows, readings, priors, rngs[1::2])
        task.begin(self.simulator, self.robots)
        usual = task.reset(self.simulator, self.robots, self.np_random, task.options)
        reset_parts(self.parts, self.robots)
        self._set_time_limit(usual)
        self.overlay.clear()
        self._blank = blank({**self.final_metrics(), "end_reason": ""}) if self.fixed_info else {}
        self.has_begun = True
        if self.on_period is not None:
            self.on_period(None)
        if self.render_mode == "human":
            self.render()

    def set_options(self, options: Mapping[str, Any] | None) -> None:
        """Set options of all further resets, such as the next stage of a curriculum. ValueError if unknown."""
        self.task.lasting_options = read_options(options, ("world", "start", *self.task.reset_options))

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Apply an action for one control period.

        Raises:
            ValueError: if the action has the wrong shape, or lies outside [-1, 1] without `clip_actions`.
            gymnasium.error.ResetNeeded: if no episode has begun, or a step has failed.
        """
        self.apply(action)
        try:
            observation, outcome = self.observe(), self.outcome()
            if self.render_mode == "human":
                self.render()
        except BaseException:
            self.has_begun = False
            raise
        return observation, *outcome

    def apply(self, action: Any) -> None:
        """Run a control period with an action, as `step` does, without computing observation and outcome."""
        commands = self.commands(action)
        try:
            self.period.run(commands)
        except BaseException:
            self.has_begun = False
            raise

    def commands(self, action: Any) -> np.ndarray:
        """Return the twists of an action, shape (num_robots, 2), float64 [m/s, rad/s]. Raises the errors of `step`."""
        self.check_begun()
        fractions = read_fractions(action, self.action_space.shape, clips=self.clip_actions, make_env=type(self))
        return self.period.act(fractions.reshape(-1, 2))

    def check_begun(self) -> None:
        """Raise `gymnasium.error.ResetNeeded` if no episode has begun, or a step has failed."""
        if not self.has_begun:
            message = f"call reset of {type(self).__name__} first: no episode has begun, or a step has failed"
            raise gymnasium.error.ResetNeeded(message)

    def outcome(self, is_last: bool = False) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of a step; `is_last` truncates the episode."""
        rewards = self.reward_terms(self.period.quantities)
        return self.judge(rewards, self.info(rewards), is_last)

    def reward_terms(self, quantities: Mapping[str, float]) -> dict[str, float]:
        """Return the reward terms of a step by name. `quantities`: those of the task."""
        rewards = self.task.rewards
        return rewards.step_terms(Quantities(quantities, self) if rewards.reads_shared else quantities)

    def judge(
        self, rewards: Mapping[str, float], info: dict[str, Any], is_last: bool, reason: str | None = None
    ) -> tuple[float, bool, bool, dict[str, Any]]:
        terminated, truncated = self.is_over
        if terminated or truncated:
            reason = self.task.end_reason
        else:
            terminated = reason is not None
        truncated |= is_last
        if terminated or truncated:
            info = info | self.final_metrics() | {"end_reason": reason or "time_limit"}
        return self.task.rewards.checked_total(rewards), terminated, truncated, info

    def final_metrics(self) -> dict[str, Any]:
        """Return the additional entries of an episode's last `info`."""
        has_people = self.simulator.crowd.params is not None or len(self.simulator.crowd.rows) > 0
        return self.task.final_metrics() | (people_metrics(self.rows.numbers) if has_people else {})

    @property
    def why_not_fused(self) -> str:
        """Reason why one kernel call cannot step many copies of this environment; empty if it can."""
        return why_not_fused(self)

    @property
    def is_over(self) -> tuple[bool, bool]:
        """Flags (terminated, truncated) of the episode."""
        terminated = self.task.end_reason is not None
        return terminated, not terminated and self.time >= self.time_limit - TIME_TOLERANCE

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return the observation in new arrays, or write it into the arrays of `out`."""
        if out is None:
            out = {name: np.empty(one.shape, one.dtype) for name, one in self.observation_space.spaces.items()}
        for name in self.parts:
            self.write_part(name, out[name])
        return dict(out)

    def write_part(self, name: str, out: np.ndarray) -> None:
        write_entries(self.parts[name], self.period.rows, out if self.task.is_team else out[None])

    def info(self, rewards: Mapping[str, float]) -> dict[str, Any]:
        """Return `info` of the last control period, with its reward terms."""
        info: dict[str, Any] = self._blank | self.task.metrics()
        if self.randomization is not None:
            info["randomized"] = dict(self.randomization.values)
        info["time"], info["rewards"] = self.time, rewards
        return info | robots_info(self.period.numbers, is_team=self.task.is_team, has_costs=self.period.has_costs)

    def prepare(self) -> None:
        """Draw the next world in advance, unless `reset` gets a seed or a world; see `EpisodeWorlds.prepare`."""
        self._worlds.prepare(self.np_random)

    @property
    def rows(self) -> Rows:
        """Arrays of all robots: measurements, pose estimates and true states."""
        return self.simulator.rows

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return float(self.rows.numbers["time"][0])

    @property
    def map_pose(self) -> Pose2D:
        """Pose (x, y, theta) of the map frame in the world frame [m, rad]."""
        return self.task.map_pose

    @property
    def reading(self) -> Reading:
        """Last sensor reading of the first robot."""
        return self.robots[0].reading

    @property
    def belief(self) -> Belief:
        """Pose estimate and map of the first robot."""
        return self.robots[0].belief

    def render(self) -> np.ndarray | None:
        """Draw the current state; return an image, shape (height, width, 3), uint8, for `rgb_array`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode; pass one to gymnasium.make")
            return None
        self.check_begun()
        return self.overlay.draw(self.scene(), self.render_mode, self.metadata["render_fps"])

    def scene(self) -> Scene:
        first, *peers = (scene_of(self, k) for k in range(len(self.robots)))
        first.peers = tuple(peers)
        return first

    def close(self) -> None:
        """End the episode; release the physics engine and the window."""
        self.has_begun = False
        self.simulator.close()
        self.overlay.close()

    def set_goal(self, goal: Sequence[float]) -> None:
        """Set the next goal, (x, y, theta) or (x, y), map frame [m, rad], and continue the episode.

        Raises:
            ValueError: if the goal is not finite or not reachable, or the task has no goal; the previous goal stays.
            gymnasium.error.ResetNeeded: if no episode has begun.
        """
        self.check_begun()
        self._set_time_limit(self.time + self.task.set_goal(goal))
        self.overlay.plan = None

    def set_initial_pose(self, pose: Sequence[float] | str) -> None:
        """Restart localization at a pose estimate, as by ROS's topic `/initialpose`, and continue the episode.

        `pose`: (x, y, theta), map frame [m, rad]; or `"unknown"` for global localization.

        Raises:
            ValueError: if the pose is not finite or outside of the map, or the task has no AMCL.
            gymnasium.error.ResetNeeded: if no episode has begun.
        """
        self.check_begun()
        self.task.set_initial_pose(pose)

    def _set_time_limit(self, usual: float | None) -> None:
        if self._time_limit is None:
            self.time_limit = DEFAULT_TIME_LIMIT if usual is None else usual


def blank(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries of `info` without values: 0, empty or False, of the same types."""
    return {k: np.zeros_like(one) if isinstance(one, np.ndarray) else type(one)() for k, one in info.items()}


def lidar_env_of(env: gymnasium.Env[Any, Any]) -> LidarEnv:
    """Return the `LidarEnv` inside wrappers or a frontier environment; raise TypeError without one."""
    inner = getattr(env.unwrapped, "explore", env.unwrapped)
    if not isinstance(inner, LidarEnv):
        raise TypeError(f"{type(inner).__name__} is not a LidarEnv")
    return inner


def make_task(task: Any, settings: Mapping[str, Any]) -> Any:
    """Create a task from a class or `module:attribute`, with `settings` as its arguments.

    Raises:
        ValueError: if `task` is not a task class.
        TypeError: if an argument is unknown.
    """
    kind: Any = resolve(task, {}, "task")
    if not (isinstance(kind, type) and issubclass(kind, Brief)):
        wanted = "a subclass of lidarnaut.envs.task.Task, or module:attribute of one"
        raise ValueError(f"task must be {wanted}, got {task!r}")
    allowed = [*inspect.signature(kind).parameters, *SHARED]
    if unknown := [name for name in settings if name not in allowed]:
        hint = explain_unknown(unknown[0], allowed)
        raise TypeError(f"task {kind.__name__} got an unexpected keyword argument {hint}")
    return kind(**settings)


SHARED = tuple(list(inspect.signature(LidarEnv.__init__).parameters)[2:-1])
"""Names of the `LidarEnv` arguments, which are common to all tasks."""
