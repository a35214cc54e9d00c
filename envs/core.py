"""Gymnasium environment of lidar robots, shared by all tasks."""

import copy
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from lidarnaut.envs.arguments import check_positive, choose_robot, clip_hint, is_number, read_action, read_options
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.estimation.dead_reckoning import DeadReckoning
from lidarnaut.envs.files import explain_unknown, resolve
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.measures import PEOPLE
from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.navigation.controllers.collision_monitor import CollisionMonitor
from lidarnaut.envs.observations import Observations, Tracks, make_parts
from lidarnaut.envs.overrides import overridden, shadowed
from lidarnaut.envs.randomization import Randomization, Ranges
from lidarnaut.envs.rendering.scene import Scene, scene_of
from lidarnaut.envs.robot import REMEMBER_TRUE, GroundTruth, Robot, reset_robots
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.sensor import Measured, make_sensors
from lidarnaut.envs.simulation import KinematicSimulator, Reading, Simulator, Twist, make_simulator
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.crowd.crowd_params import PeopleLike, crowd_of
from lidarnaut.envs.simulation.rows import Rows
from lidarnaut.envs.task import DEFAULT_TIME_LIMIT, Brief, Quantities
from lidarnaut.envs.transition import people_metrics, pose_errors, update_robots
from lidarnaut.envs.worlds import World

NO_TRACKS = np.empty((0, 5))
"""Empty array of tracked people, shape (0, 5): x, y [m], vx, vy [m/s], radius [m]."""
WORLD_SPAWN_KEY = 2**32 - 1
"""Spawn key of the random generator for worlds. `Generator.spawn` never produces this key."""


class WholeStep:
    """Context manager that makes an environment require a reset if an exception interrupts a step."""

    def __init__(self, env: "LidarEnv") -> None:
        self._env = env

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._env.has_begun = False


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
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}
    uses_ground_truth: bool = False
    """Whether observations contain ground truth; subclasses may set it."""

    def __init__(
        self,
        task: Any,
        *,
        robot: str | RobotParams | None = None,
        physics: str | type[Simulator] = "bullet",
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
        **settings: Any,
    ) -> None:
        """Create an environment.

        `task`: subclass of `lidarnaut.envs.task.Task`, or `module:attribute` of one. `settings`: arguments of the task.
        The class docstring describes the other arguments.

        Raises:
            ValueError: if the value of an argument is not allowed.
            TypeError: if the task has no such argument.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        check_positive(control_hz=control_hz)
        if time_limit is not None and time_limit != math.inf and not (is_number(time_limit) and time_limit > 0):
            raise ValueError(f"time_limit must be positive or None, got {time_limit!r}")
        self.task = make_task(task, settings)
        self.robot = choose_robot(robot, getattr(self.task, "world", ""))
        """Nominal robot parameters; randomization changes only the simulated robot."""
        self.control_period = period = 1.0 / control_hz
        self.task.attach(self.robot, period, physics if isinstance(physics, str) else physics.__name__)
        num_robots = self.task.num_robots
        self.simulator = make_simulator(physics, self.robot, period, num_robots, crowd_of(people))
        if people is not None:
            self.task.measures = (*self.task.measures, *PEOPLE)
        estimators, by_truth = [self.task.make_estimator() for _ in range(num_robots)], self.task.uses_true_motion
        self.robots = [Robot(self.robot, period, each, uses_true_motion=by_truth) for each in estimators]
        self._randomization: Randomization | None = None
        if randomize:
            self._randomization = Randomization(randomize, self.robot, self.simulator.ignored)
            self.simulator.set_robot(self._randomization.robot(self._randomization.highest))
        self.time_limit = time_limit or math.inf
        """Maximum duration of the episode [s]."""
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(control_hz))}
        self.plans: list[np.ndarray | None] = [None] * num_robots
        """Planned path of each robot for rendering, shape (n, 2), map frame [m], or None; set by the user, cleared by
        `reset`."""
        self.tracks = NO_TRACKS
        """People tracked by the first robot, for rendering, shape (n, 5): x, y, vx, vy, radius, map frame [m, m/s]; set
        by the user, cleared by `reset`."""
        self.markers: Callable[[], Markers | None] | None = None
        """Function that returns the markers of the policy, for rendering; set by the user, cleared by `reset`."""
        self.on_period: Callable[[Sequence[Twist] | None], None] | None = None
        """Callback of recorders, called with None after a reset and with the commanded twists after each control
        period."""
        self._time_limit = time_limit
        self.clip_actions = clip_actions
        self._is_team = self.task.is_team
        self.collision_monitor = CollisionMonitor(self.robot, period) if collision_monitor else None
        self.sensors = make_sensors(sensors)
        measured = {sensor.name: partial(Measured, sensor) for sensor in self.sensors}
        chosen = self.task.default_observations() if observations is None else observations
        self.parts = make_parts(chosen, {**measured, **self.task.observation_parts()})
        space: Any = spaces.Dict({name: part.space(self.robot) for name, part in self.parts.items()})
        self.observation_space: spaces.Space[Any] = batch_space(space, num_robots) if self._is_team else space
        space = self.observation_space
        for one in self.robots:
            has_map = self.simulator.crowd.crowd is not None and not isinstance(one.estimator, DeadReckoning)
            is_observed = any(isinstance(part, Tracks) for part in self.parts.values())
            if is_observed or (has_map if track_people is None else track_people):
                one.track_people()
        self.uses_ground_truth |= any(getattr(part, "uses_ground_truth", False) for part in self.parts.values())
        self._layout: list[tuple[str, Any, Any]] = [
            (name, space[name].shape, space[name].dtype) for name in space.spaces
        ]
        self._action_shape = (num_robots, 2) if self._is_team else (2,)
        self.action_space = spaces.Box(-1.0, 1.0, self._action_shape, np.float32)
        self._root: np.random.Generator | None = None
        self._prepared: tuple[Any, ...] = (None,) * 4
        self.whole_step, self._fixed_info = WholeStep(self), fixed_info
        self.has_begun = False
        self._blank: dict[str, Any] = {}
        self._renderer: Any = None
        for k, one in enumerate(self.robots):
            one.peers = [*self.robots[:k], *self.robots[k + 1 :]]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode and return the first observation and info.

        Args:
            seed: seed of all random numbers.
            options: settings of this episode: `world`, `start` and `reset_options` of the task, with values as in the
                constructor.

        Raises:
            ValueError: if an option is unknown or has a value that is not allowed.
        """
        self.begin(seed=seed, options=options)
        return self.observe(), self.info(dict.fromkeys(self.task.rewards.weights, 0.0))

    def begin(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start an episode as `reset` does, without computing observation and info."""
        task, num_robots, options = self.task, len(self.robots), read_options(options)
        allowed = ("world", "start", *task.reset_options)
        if unknown := sorted(map(str, set(options) - set(allowed))):
            raise ValueError(f"reset has unknown options {unknown}; allowed are {list(allowed)}")
        super().reset(seed=seed)
        self.has_begun = False
        task.options = {key: options[key] for key in task.reset_options if key in options}
        self.world = task.place(self._next_world(options.get("world")), options.get("start"))
        starts = task.choose_starts(self.world, options.get("start"), self.np_random)
        rngs = self.np_random.spawn(2 * num_robots)
        if self._randomization is not None:
            # Spawned last: randomization does not change other parts of the episode.
            self.randomized = self._randomization.draw(self.np_random.spawn(1)[0])
            self.simulator.set_robot(self._randomization.robot(self.randomized))
        # Spawned last: sensors and people do not change other parts of the episode.
        sensor_rngs = self.np_random.spawn(len(self.sensors))
        crowd_rng = self.np_random.spawn(1)[0] if self.simulator.crowd.crowd else None
        readings = self.simulator.reset(self.world, starts, rngs[::2], crowd_rng)
        rows = self.simulator.rows
        rows.numbers[:, at.MAP_POSE : at.MAP_POSE + 3] = task.map_pose
        self.truths = [GroundTruth(rows, k) for k in range(num_robots)]
        if self.sensors:
            for sensor, rng in zip(self.sensors, sensor_rngs, strict=True):
                sensor.reset(self.world, rng)
            readings = self._measure(readings)
        self.priors = [task.prior(k, rng) for k, rng in enumerate(rngs[1::2])]
        """Initial pose, covariance and map of each robot."""
        reset_robots(self.robots, rows, readings, self.priors, rngs[1::2])
        task.begin(self.simulator, self.robots)
        usual = task.reset(self.simulator, self.robots, self.np_random, task.options)
        for part in self.parts.values():
            if hasattr(part, "reset"):
                for robot in self.robots:
                    part.reset(robot)
        self._set_time_limit(usual)
        self.plans, self.tracks, self.markers = [None] * num_robots, NO_TRACKS, None
        for name, value in ({**self.final_metrics(), "end_reason": ""} if self._fixed_info else {}).items():
            self._blank[name] = np.zeros_like(value) if isinstance(value, np.ndarray) else type(value)()
        self.has_begun = True
        if self.on_period is not None:
            self.on_period(None)
        if self.render_mode == "human":
            self.render()

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Apply an action for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1] without
                `clip_actions`.
            gymnasium.error.ResetNeeded: if no episode has begun, or a step has failed.
        """
        self.apply(action)
        with self.whole_step:
            observation, outcome = self.observe(), self.outcome()
            if self.render_mode == "human":
                self.render()
        return observation, *outcome

    def apply(self, action: Any) -> None:
        commands = self.twists(action)
        with self.whole_step:
            self.advance(commands)

    def twists(self, action: Any) -> list[Twist]:
        self.check_begun()
        action = read_action(action).astype(np.float32, copy=False)
        if action.shape != self._action_shape:
            raise ValueError(f"action must have shape {self._action_shape}, got {action.shape}")
        rows = action.tolist() if self._is_team else [action.tolist()]
        max_v, max_w = self.robot.max_v, self.robot.max_w
        twists = []
        for robot, (v, w) in zip(self.robots, rows, strict=True):
            if not (-1.0 <= v <= 1.0 and -1.0 <= w <= 1.0):
                if not self.clip_actions or math.isnan(v) or math.isnan(w):
                    hint = clip_hint(type(self), action)
                    raise ValueError(f"action must be finite and lie in [-1, 1], got {action}{hint}")
                v, w = min(max(v, -1.0), 1.0), min(max(w, -1.0), 1.0)
            robot.action = (v, w)
            twists.append(Twist(v * max_v, w * max_w))
        return self.limited(twists)

    def limited(self, twists: list[Twist]) -> list[Twist]:
        """Return commands [m/s, rad/s], slowed down by the collision monitor, if any."""
        if self.collision_monitor is None:
            return twists
        commands = np.array(twists)
        self.collision_monitor.slow_down(commands, self.rows.ranges, np.ones(len(commands), dtype=np.bool_))
        return [Twist(v, w) for v, w in commands.tolist()]

    def check_begun(self) -> None:
        """Raise `gymnasium.error.ResetNeeded` if no episode has begun, or a step has failed."""
        if not self.has_begun:
            message = f"call reset of {type(self).__name__} first: no episode has begun, or a step has failed"
            raise gymnasium.error.ResetNeeded(message)

    def advance(self, commands: Sequence[Twist]) -> None:
        self.simulator.move(commands)  # world -> physics -> sensors
        update_robots(self.rows.numbers, self.simulator.crowd.rows)  # odometry -> predicted poses
        self.finish()

    def finish(self) -> None:
        """Update estimates, task and recorder after the motion of a control period."""
        if self.sensors:
            readings = self._measure([robot.reading for robot in self.robots])
            for robot, reading in zip(self.robots, readings, strict=True):
                robot.reading = reading
        self.locate()
        self.update_task()
        if self.on_period is not None:
            numbers = self.rows.numbers[:, at.COMMAND_V : at.COMMAND_W + 1]
            self.on_period([Twist(v, w) for v, w in numbers.tolist()])

    def update_task(self) -> None:
        """Update the task and the quantities of its reward; called once in each control period."""
        period = self.control_period
        self.task.update(self.simulator, self.robots, period)
        self.quantities = {"time": period, **self.task.quantities()}
        if "collision" not in self.quantities:
            self.quantities["collision"] = period * sum(robot.bumper for robot in self.robots)

    def locate(self) -> None:
        flags = self.rows.numbers[:, at.FLAGS].tolist()
        for robot, truth, flag in zip(self.robots, self.truths, flags, strict=True):
            robot.locate(int(flag))  # scan matching -> map
            if int(flag) & REMEMBER_TRUE:
                truth.remember()

    def _measure(self, readings: Sequence[Reading]) -> list[Reading]:
        return [
            reading._replace(extra={sensor.name: sensor.measure(self.simulator, k) for sensor in self.sensors})
            for k, reading in enumerate(readings)
        ]

    def outcome(self, is_last: bool = False) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of a step; `is_last` truncates the episode."""
        rewards = self.reward_terms(self.quantities)
        return self.judge(rewards, self.info(rewards), is_last)

    def reward_terms(self, quantities: Mapping[str, float]) -> dict[str, float]:
        """Return the reward terms of a step by name. `quantities`: those of the task."""
        rewards = self.task.rewards
        return rewards.terms(Quantities(quantities, self) if rewards.reads_shared else quantities)

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
        has_people = self.simulator.crowd.crowd is not None or len(self.simulator.crowd.rows) > 0
        return self.task.final_metrics() | (people_metrics(self.rows.numbers) if has_people else {})

    @property
    def is_fused(self) -> bool:
        """Whether one kernel call can step many copies of this environment."""
        return not self.why_not_fused

    @property
    def why_not_fused(self) -> str:
        """Reason why one kernel call cannot step many copies of this environment; empty if it can."""
        physics = type(self.simulator)
        owned, used = (self, self.simulator, *self.robots), (self.task, self.task.rewards, *self.parts.values())
        for one, own in [*zip(owned, map(overridden, owned)), *zip(used, map(shadowed, used))]:
            if own:
                return f"{type(one).__name__} overrides {own[0]}"
        if self._fixed_info:
            return "fixed_info adds entries of the last step to every info"
        if self.robot.lidar.scan_time:
            return "scans of a lidar that spins are deskewed in Python"
        return "" if physics is KinematicSimulator else f"{physics.__name__} steps in Python"

    @property
    def is_over(self) -> tuple[bool, bool]:
        """Flags (terminated, truncated) of the episode."""
        terminated = self.task.end_reason is not None
        return terminated, not terminated and self.time >= self.time_limit - 1e-6

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return the observation in new arrays, or write it into the arrays of `out`."""
        if out is None:
            out = {name: np.empty(shape, dtype) for name, shape, dtype in self._layout}
        for name in self.parts:
            self.write_part(name, out[name])
        return dict(out)

    def write_part(self, name: str, out: np.ndarray) -> None:
        part: Any = self.parts[name]
        shows_truth = self.uses_ground_truth and getattr(part, "uses_ground_truth", False)
        if not (shows_truth or self._is_team):
            part.write(self.robots[0], out)
            return
        for robot, truth, row in zip(self.robots, self.truths, out if self._is_team else (out,), strict=True):
            part.write(robot, row, *(truth,) * shows_truth)

    def info(self, rewards: dict[str, float]) -> dict[str, Any]:
        info: dict[str, Any] = self._blank | self.task.metrics()
        rows = self.rows.numbers
        if self._randomization is not None:
            info["randomized"] = dict(self.randomized)
        info["time"], info["rewards"], info["pose_error"] = self.time, rewards, pose_errors(rows)
        if self._is_team:
            info["path_length"] = rows[:, at.PATH_LENGTH].copy()
            info["collisions"] = rows[:, at.COLLISIONS].astype(np.int64)
        else:
            info["pose_error"], info["path_length"] = info["pose_error"][0], float(rows[0, at.PATH_LENGTH])
            info["collisions"] = int(rows[0, at.COLLISIONS])
        return info

    def prepare(self) -> None:
        """Draw the next world in advance if the task permits this (`sampler_ahead`).

        May run in another thread between two resets. The world is unused if `reset` gets a seed or a world.
        """
        sampler = self.task.sampler_ahead
        if sampler is not None and self._root is self.np_random:
            before, after = self._world_rng, copy.deepcopy(self._world_rng)
            self._prepared = sampler, before, after, self.task.draw_world(None, after)

    @property
    def rows(self) -> Rows:
        """Arrays of all robots: measurements, pose estimates and true states."""
        return self.simulator.rows

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return float(self.rows.numbers[0, at.TIME])

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

    @property
    def plan(self) -> np.ndarray | None:
        return self.plans[0]

    @plan.setter
    def plan(self, path: np.ndarray | None) -> None:
        self.plans[0] = path

    def render(self) -> np.ndarray | None:
        """Draw the current state; return an image, shape (height, width, 3), uint8, for `rgb_array`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode; pass one to gymnasium.make")
            return None
        self.check_begun()
        if self._renderer is None:
            from lidarnaut.envs.rendering import Renderer

            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"])
        return self._renderer.draw(self.scene())

    def scene(self) -> Scene:
        first, *peers = (scene_of(self, k) for k in range(len(self.robots)))
        first.peers = tuple(peers)
        return first

    def close(self) -> None:
        """End the episode; release the physics engine and the window."""
        self.has_begun = False
        self.simulator.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}

    def set_goal(self, goal: Sequence[float]) -> None:
        """Set the next goal, (x, y, theta) or (x, y), map frame [m, rad], and continue the episode.

        Raises:
            ValueError: if the goal is not finite or not reachable, or the task has no goal; the previous goal stays.
            gymnasium.error.ResetNeeded: if no episode has begun.
        """
        self._set_time_limit(self.time + self._of_task("set_goal")(goal))
        self.plan = None

    def set_initial_pose(self, pose: Sequence[float] | str) -> None:
        """Restart localization at a pose estimate, as by ROS's topic `/initialpose`, and continue the episode.

        `pose`: (x, y, theta), map frame [m, rad]; or `"unknown"` for global localization.

        Raises:
            ValueError: if the pose is not finite or outside of the map, or the task has no AMCL.
            gymnasium.error.ResetNeeded: if no episode has begun.
        """
        self._of_task("set_initial_pose")(pose)

    def _of_task(self, method: str) -> Any:
        self.check_begun()
        if not hasattr(self.task, method):
            raise ValueError(f"task {type(self.task).__name__} does not support {method}")
        return getattr(self.task, method)

    def _next_world(self, wanted: Any) -> World:
        (sampler, before, after, world), self._prepared = self._prepared, (None,) * 4
        if self._root is not self.np_random:
            self._root, root = self.np_random, self.np_random.bit_generator.seed_seq
            key = (*root.spawn_key, WORLD_SPAWN_KEY)  # type: ignore[attr-defined]
            self._world_rng = np.random.default_rng(np.random.SeedSequence(root.entropy, spawn_key=key))  # type: ignore[attr-defined]
            return self.task.draw_world(wanted, self.np_random)
        if wanted is None and before is self._world_rng and sampler is self.task.sampler_ahead:
            self._world_rng = after
            return world
        rng = copy.deepcopy(self._world_rng)  # `prepare` may copy the original now
        try:
            return self.task.draw_world(wanted, rng)
        finally:
            self._world_rng = rng

    def _set_time_limit(self, usual: float | None) -> None:
        if self._time_limit is None:
            self.time_limit = DEFAULT_TIME_LIMIT if usual is None else usual


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
