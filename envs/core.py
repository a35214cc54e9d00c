"""The environment: simulation + estimation + task + observations, for one robot or several."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from envs.arguments import check_positive, clip_hint, is_number, read_action, read_options
from envs.estimation import Belief, Estimator
from envs.estimation.motion import TrueMotion, make_motion_source
from envs.geometry import Pose2D
from envs.ground_truth import GroundTruth, pose_error
from envs.observations import Observations, make_parts
from envs.randomization import Randomization, Ranges
from envs.robot import Robot, reset_robots
from envs.robots import RobotParams
from envs.sensor import Measured, make_sensors
from envs.simulation import Reading, Simulator, Twist, make_simulator
from envs.task import Task
from envs.worlds import World


class LidarEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Lidar robots in a world, driven by twists, one control period in a step.

    Subclasses give it a task; see `envs.tasks`. Actions are forward speed and yaw rate (counter-clockwise) as fractions
    of the robot's limits; `clip_actions` says what happens to those outside [-1, 1].
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        task: Task,
        simulator: Simulator,
        robots: Sequence[Robot],
        observations: Observations,
        *,
        control_hz: float,
        time_limit: float | None,
        render_mode: str | None,
        clip_actions: bool = False,
        is_team: bool = False,
        randomize: Ranges | None = None,
        sensors: Sequence[Any] = (),
    ) -> None:
        """Assemble an environment.

        Args:
            task: what it is about.
            simulator: holds the robots' bodies.
            robots: what each of them senses and estimates.
            observations: parts of the observation.
            control_hz: steps per second.
            time_limit: length of an episode [s]; None for the task's usual one.
            render_mode: None, "human" or "rgb_array".
            clip_actions: whether actions outside [-1, 1] are clipped, or refused.
            is_team: whether actions and observations have an axis for the robots.
            randomize: ranges of the true robot's parameters, which each episode draws; see `envs.randomization`.
            sensors: sensors of the user's own, see `envs.sensor.make_sensors`.

        Raises:
            ValueError: if one is not allowed; the message names it and what is.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        check_positive(control_hz=control_hz)
        if time_limit is not None and time_limit != math.inf and not (is_number(time_limit) and time_limit > 0):
            raise ValueError(f"time_limit must be positive or None, got {time_limit!r}")
        self.task = task
        self.simulator = simulator
        self.robots = list(robots)
        self.robot = robots[0].params
        """The nominal robot, as everything but the simulator takes it to be."""
        self._randomization: Randomization | None = None
        if randomize:
            self._randomization = Randomization(randomize, self.robot, simulator.ignored)
            # Room for what any episode may draw.
            simulator.set_robot(self._randomization.robot(self._randomization.highest))
        self.control_period = 1.0 / control_hz
        self.time_limit = time_limit or math.inf
        """Length of the episode [s]."""
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(control_hz))}
        self.plans: list[np.ndarray | None] = [None] * len(self.robots)
        """Planned path of each robot for drawing, shape (n, 2), map frame [m]; set them from outside, `reset` clears
        them."""
        self.on_period: Callable[[Sequence[Twist] | None], None] | None = None
        """Called after a reset with None, and after each control period with the commands, to record the episode."""
        self._time_limit = time_limit
        self.clip_actions = clip_actions
        self._is_team = is_team
        self.sensors = make_sensors(sensors)
        measured = {sensor.name: partial(Measured, sensor) for sensor in self.sensors}
        self.parts = make_parts(observations, {**measured, **task.observation_parts()})
        self.observation_space: spaces.Space[Any] = self._make_observation_space()
        self._action_shape = (len(self.robots), 2) if is_team else (2,)
        self.action_space = spaces.Box(-1.0, 1.0, self._action_shape, np.float32)
        space: Any = self.observation_space
        self._layout: list[tuple[str, Any, Any]] = [(name, space[name].shape, space[name].dtype) for name in self.parts]
        self._prepared: tuple[Mapping[str, Any], World] | None = None
        self._has_begun = False
        self._renderer: Any = None
        for k, robot in enumerate(self.robots):
            robot.peers = [*self.robots[:k], *self.robots[k + 1 :]]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode and return the first observation and info.

        Args:
            seed: of everything random.
            options: choices for this episode alone: `world`, `start`, and those of the task (`reset_options`), with the
                values that the constructor's arguments of the same names take.

        Raises:
            ValueError: if an option is unknown or not allowed.
        """
        self.begin(seed=seed, options=options)
        return self.observe(), self.info(dict.fromkeys(self.task.weights.names(), 0.0))

    def begin(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start an episode without observation and info; arguments and errors as for `reset`."""
        options = self._check_options(options)
        super().reset(seed=seed)
        task, num_robots = self.task, len(self.robots)
        self._has_begun = False  # unless all of it succeeds
        self.world = self._next_world(options, seed is not None)
        starts = task.choose_starts(self.world, options.get("start"), self.np_random)
        rngs = self.np_random.spawn(2 * num_robots)
        if self._randomization is not None:
            # After all others and from a generator of its own: the same seed without randomization has the same
            # world, starts and task.
            self.randomized = self._randomization.draw(self.np_random.spawn(1)[0])
            self.simulator.set_robot(self._randomization.robot(self.randomized))
        readings = self.simulator.reset(self.world, starts, rngs[::2])
        self.truths = [GroundTruth(state) for state in self.simulator.states]
        own = {key: options[key] for key in task.reset_options if key in options}
        readings = self._with_extra(readings, is_first=True)
        priors = [task.prior(k, rng) for k, rng in enumerate(rngs[1::2])]
        reset_robots(self.robots, readings, priors, rngs[1::2])
        usual = task.reset(self.simulator, self.robots, self.np_random, own)
        for part in self.parts.values():
            if hasattr(part, "reset"):
                for robot in self.robots:
                    part.reset(robot)
        self._set_time_limit(usual)
        self.plans = [None] * num_robots
        self._has_begun = True
        if self.on_period is not None:
            self.on_period(None)
        if self.render_mode == "human":
            self.render()

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1] and is not clipped.
            gymnasium.error.ResetNeeded: if no episode has begun.
        """
        self.apply(action)
        outcome = self.outcome()
        if self.render_mode == "human":
            self.render()
        return self.observe(), *outcome

    def apply(self, action: Any) -> None:
        """Drive for one control period without an observation or outcome; raises as `step`."""
        self.advance(self.twists(action))

    def twists(self, action: Any) -> list[Twist]:
        """Return the twists that an action commands, and let the robots remember it; raises as `step`."""
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
        return twists

    def check_begun(self) -> None:
        """Make sure that an episode has begun.

        Raises:
            gymnasium.error.ResetNeeded: if none has: `reset` was not called, or failed.
        """
        if not self._has_begun:
            raise gymnasium.error.ResetNeeded(f"call reset of {type(self).__name__} first: no episode has begun")

    def advance(self, commands: Sequence[Twist]) -> None:
        """Drive for one control period without making observation, reward or info."""
        robots, simulator = self.robots, self.simulator
        readings = self._with_extra(simulator.step(commands))  # world -> physics -> sensors
        states = simulator.states
        for robot, reading, truth, state in zip(robots, readings, self.truths, states, strict=True):
            robot.sense(reading)  # odometry
            truth.update(state)
        for robot in robots:
            robot.locate()  # scan matching -> map
        self.task.update(simulator, robots, self.control_period)
        if self.on_period is not None:
            self.on_period(commands)

    def _with_extra(self, readings: list[Reading], is_first: bool = False) -> list[Reading]:
        """Return the readings with what the user's own sensors measure."""
        if not self.sensors:
            return readings
        if is_first:  # a generator after all others: the same seed without sensors has the same episode
            for sensor, rng in zip(self.sensors, self.np_random.spawn(len(self.sensors)), strict=True):
                sensor.reset(self.world, rng)
        return [
            reading._replace(extra={sensor.name: sensor.measure(self.simulator, k) for sensor in self.sensors})
            for k, reading in enumerate(readings)
        ]

    def outcome(self, is_last: bool = False) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of the last control period.

        Args:
            is_last: whether to truncate the episode here though there is time left.
        """
        rewards = self.task.weights.terms(self.task.quantities())
        terminated, truncated = self.is_over
        truncated = truncated or (is_last and not terminated)
        info = self.info(rewards)
        if terminated or truncated:
            info |= self.task.final_metrics()
            info["end_reason"] = self.task.end_reason or "time_limit"
        return sum(rewards.values()), terminated, truncated, info

    @property
    def is_over(self) -> tuple[bool, bool]:
        """Whether the episode is terminated, and whether it is truncated."""
        terminated = self.task.end_reason is not None
        return terminated, not terminated and self.time >= self.time_limit - 1e-6

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return the observation in fresh arrays, or write it to the arrays of `out`."""
        if out is None:
            out = {name: np.empty(shape, dtype) for name, shape, dtype in self._layout}
        for name, part in self.parts.items():
            if self._is_team:
                for robot, row in zip(self.robots, out[name], strict=True):
                    part.write(robot, row)
            else:
                part.write(self.robots[0], out[name])
        return dict(out)

    def info(self, rewards: dict[str, float]) -> dict[str, Any]:
        """Return what there is to tell of this moment."""
        info, map_pose = self.task.metrics(), self.task.map_pose
        errors = np.array(
            [
                pose_error(*map_pose, *robot.belief.pose, *truth.state.pose)
                for robot, truth in zip(self.robots, self.truths, strict=True)
            ]
        )
        if self._randomization is not None:
            info["randomized"] = dict(self.randomized)
        info["time"] = self.time
        info["rewards"] = rewards
        if self._is_team:
            info["pose_error"] = errors
            info["path_length"] = np.array([truth.path_length for truth in self.truths])
            info["collisions"] = np.array([robot.collisions for robot in self.robots], dtype=np.int64)
        else:
            info["pose_error"] = errors[0]
            info["path_length"] = self.truths[0].path_length
            info["collisions"] = self.robots[0].collisions
        return info

    def prepare(self) -> None:
        """Draw the world of the next episode ahead of time; a `reset` with a seed or a world throws it away.

        May run in another thread between two resets: nothing else draws from the environment's generator meanwhile.
        """
        if self._prepared is None:
            state = self.np_random.bit_generator.state
            self._prepared = state, self.task.draw_world(None, self.np_random)

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.robots[0].reading.time

    @property
    def map_pose(self) -> Pose2D:
        """Pose of the map frame in the world."""
        return self.task.map_pose

    @property
    def reading(self) -> Reading:
        """What the sensors of the first robot say."""
        return self.robots[0].reading

    @property
    def belief(self) -> Belief:
        """Pose estimate and map of the first robot."""
        return self.robots[0].belief

    @property
    def plan(self) -> np.ndarray | None:
        """Planned path of the first robot for drawing; see `plans`."""
        return self.plans[0]

    @plan.setter
    def plan(self, path: np.ndarray | None) -> None:
        self.plans[0] = path

    def render(self) -> np.ndarray | None:
        """Draw this moment; an array (height, width, 3), uint8, for `rgb_array`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode; pass one to gymnasium.make")
            return None
        self.check_begun()
        if self._renderer is None:
            from envs.rendering import Renderer

            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"], make_picture=self._painter())
        return self._renderer.draw(self.scene())

    def scene(self) -> Any:
        """Return this moment for drawing; environments that can be rendered define it."""
        raise NotImplementedError(f"{type(self).__name__} cannot be rendered: it does not define scene()")

    def _painter(self) -> Any:
        """Return what makes the picture that scenes are painted in, see `envs.rendering.Renderer`; None for its own."""
        return None

    def close(self) -> None:
        """Release the physics engine and the window; the episode ends."""
        self._has_begun = False
        self.simulator.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the window behind when pickled."""
        return {**self.__dict__, "_renderer": None}

    def _make_observation_space(self) -> spaces.Dict:
        space = spaces.Dict({name: part.space(self.robot) for name, part in self.parts.items()})
        return batch_space(space, len(self.robots)) if self._is_team else space  # type: ignore[return-value]

    def _check_options(self, options: Mapping[str, Any] | None) -> dict[str, Any]:
        allowed = ("world", "start", *self.task.reset_options)
        options = read_options(options)
        if unknown := sorted(map(str, set(options) - set(allowed))):
            raise ValueError(f"reset has unknown options {unknown}; allowed are {list(allowed)}")
        return options

    def _next_world(self, options: Mapping[str, Any], is_seeded: bool) -> World:
        """Return the world of an episode: the prepared one if it is the one that would be drawn now."""
        prepared, self._prepared = self._prepared, None
        if prepared is not None and not is_seeded:
            state, world = prepared
            if "world" not in options:
                return world
            self.np_random.bit_generator.state = state
        return self.task.draw_world(options.get("world"), self.np_random)

    def _set_time_limit(self, usual: float) -> None:
        if self._time_limit is None:
            self.time_limit = usual


def lidar_env_of(env: gymnasium.Env[Any, Any]) -> LidarEnv:
    """Return the environment in which robots drive, whatever wraps it, and be they driven by twists or decisions.

    Raises:
        TypeError: there is none in it.
    """
    inner = getattr(env.unwrapped, "explore", env.unwrapped)
    if not isinstance(inner, LidarEnv):
        raise TypeError(f"{type(inner).__name__} is no LidarEnv")
    return inner


def make_robots(
    params: RobotParams,
    physics: str,
    control_hz: float,
    make_estimator: Callable[[], Estimator],
    *,
    uses_truth: bool = False,
    num_robots: int = 1,
) -> tuple[Simulator, list[Robot]]:
    """Return a simulator of equal robots, and the robots.

    Args:
        params: the robots.
        physics: "bullet" or "kinematic".
        control_hz: control periods per second.
        make_estimator: makes the estimator of a robot.
        uses_truth: whether estimators get the true motion in place of odometry's.
        num_robots: how many there are.

    Raises:
        ValueError: if one is not allowed; the message names it and what is.
    """
    check_positive(control_hz=control_hz)
    period = 1.0 / control_hz
    simulator = make_simulator(physics, params, period, num_robots)
    robots = []
    for k in range(num_robots):
        truth = TrueMotion(partial(_true_pose, simulator, k)) if uses_truth else None
        robots.append(Robot(params, period, make_estimator(), make_motion_source(params, period), truth))
    return simulator, robots


def _true_pose(simulator: Simulator, index: int) -> Pose2D:
    return simulator.states[index].pose
