"""Run episodes of a policy in an environment, and measure its performance."""

import logging
import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces

from lidarnaut.envs.core import LidarEnv, lidar_env_of
from lidarnaut.envs.files import explain_unknown
from lidarnaut.envs.measures import EpisodeHistory, HistoryRecorder, measures_of
from lidarnaut.envs.navigation import HomeNavigator
from lidarnaut.envs.navigation.controllers.local_planner import NO_TRACKS
from lidarnaut.envs.rendering.scene import people_in

from .adoption import adopt
from .frontier.rule_explorer import RuleExplorer
from .policy import Explorer, ObservationPolicy, Policy, PrivilegedPolicy, to_action

LOGGER = logging.getLogger(__name__)
LOG_PERIOD = 10.0
"""Simulated time between messages about the progress of an episode [s]."""
Info = dict[str, Any]
Observation = dict[str, np.ndarray]
Decide = Callable[[Observation], np.ndarray | np.integer | str]
"""Function from an observation to an action, or to a string: the reason to end the episode."""
Watch = Callable[[Info], None]
"""Function called with `info` after the reset and after every step."""


class LastInfo(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper that adds final metrics and `end_reason` to `info` if an inner wrapper (time limit) ends the episode."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, Info]:
        *outcome, terminated, truncated, info = self.env.step(action)
        if (terminated or truncated) and not info.get("end_reason"):
            reason = "time_limit" if truncated else "terminated"
            info = {**info, **lidar_env_of(self.env).final_metrics(), "end_reason": reason}
        return *outcome, terminated, truncated, info


class Ended(NamedTuple):
    """Last observation, last `info` and computing times of a run."""

    observation: Observation
    info: Info
    """Last `info` of the run. Contains `end_reason`, unless `max_steps` ended the run."""
    decision_times: list[float]
    """Computing time of each action [s]."""


def run(
    env: gymnasium.Env[Any, Any],
    decide: Decide,
    observation: Observation,
    info: Info,
    watch: Watch | None = None,
    *,
    max_steps: float = math.inf,
    clock: Callable[[], float] = time.perf_counter,
) -> Ended:
    """Step an environment until the episode ends or `decide` returns a string (reason to stop).

    `observation`, `info`: results of the reset or of the last step. `watch`: called with `info` at the start and after
    every step. `clock`: returns the time [s].
    """
    env, decision_times, watch = LastInfo(env), list[float](), watch or (lambda _: None)
    watch(info)
    while len(decision_times) < max_steps:
        began = clock()
        action = decide(observation)
        decision_times.append(clock() - began)
        if isinstance(action, str):
            info = {**info, **lidar_env_of(env).final_metrics(), "end_reason": action}
            break
        observation, _, terminated, truncated, info = env.step(action)
        watch(info)
        if terminated or truncated:
            break
    return Ended(observation, info, decision_times)


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """Performance measures of one episode. Times are simulated, distances are true.

    Measures such as the time to 95 % coverage are infinite if not reached. Statistics replace infinity by `time_limit`
    or `distance_limit`.
    """

    values: Mapping[str, float]
    """Performance measures by name, such as `time_to_95`. Each is also an attribute of this object."""
    history: EpisodeHistory
    """Numeric entries of `info` at the reset and after every step."""
    decision_times: np.ndarray
    """Processor time of each action, in all threads [s], shape (k,), float64."""
    end_reason: str
    """Reason for the end of the episode: from the task or the policy, or `"time_limit"`."""
    duration: float
    """Simulated time at the end of the episode [s]."""
    time_limit: float
    """Maximum simulated time of the episode [s]."""
    distance_limit: float
    """Distance covered at maximum speed within the time limit [m]."""

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:.4g}" for name, value in self.values.items())
        return f"Episode(end_reason={self.end_reason!r}, duration={self.duration:.1f}, {values})"

    @property
    def decision_ms(self) -> float:
        """Mean processor time per action [ms]."""
        return 1000.0 * float(np.mean(self.decision_times))

    def __getattr__(self, name: str) -> float:
        if name.startswith("_") or name not in self.values:
            raise AttributeError(f"unknown measure of the task, {explain_unknown(name, self.values)}")
        return self.values[name]


def begin_episode(env: gymnasium.Env, policy: Policy, seed: int, rng: np.random.Generator) -> tuple[Observation, Info]:
    """Reset an environment and a policy; return the first observation and `info`.

    A route of the task is passed to the policy's `set_route`, and ground truth to a `PrivilegedPolicy`.
    """
    observation, info = env.reset(seed=seed)
    policy = adopt(policy)
    inner, rate = lidar_env_of(env), policy.control_hz
    period = inner.control_period * _repeats(policy, env)
    if rate and abs(period * rate - 1.0) > 0.01 and not _chooses(env):
        name = type(policy).__name__
        warnings.warn(f"{name} has control_hz {rate:g}, but decides every {period:.3g} s here", stacklevel=2)
    policy.reset(inner.robot_params, period, rng)
    if isinstance(policy, PrivilegedPolicy) and inner.task.coverage is not None:
        policy.reveal(inner.task.coverage, inner.task.target_coverage)
    if inner.task.route is not None:
        policy.set_route(inner.task.route)
    return observation, info


def decide_with(policy: Policy, env: gymnasium.Env[Any, Any]) -> Decide:
    """Return a function that computes a policy's action for an observation of an environment.

    For policies with a lower `control_hz`, the function repeats actions. With `return_home`, a navigator drives home
    after exploration. Planned paths and markers are stored for rendering.
    """
    policy = adopt(policy)
    inner, repeats, calls = lidar_env_of(env), _repeats(policy, env), 0
    decide_once, task = _decide_once(policy, env), inner.task
    if not _chooses(env):
        inner.overlay.markers = lambda: policy.markers
    is_called_back = task.return_home and not _chooses(env)
    home = HomeNavigator(inner.robot_params, inner.control_period, inner.np_random) if is_called_back else None
    action: Any = None

    def decide(observation: Observation) -> np.ndarray | np.integer | str:
        nonlocal action, calls
        if home is not None and task.is_returning:
            twist = home.act(inner.reading, inner.belief)
            inner.overlay.plan = home.plan
            return home.home_reason or to_action(twist, inner.robot_params)
        if calls % repeats == 0:
            action = decide_once(observation)
        calls += 1
        if home is not None and policy.end_reason is not None:
            task.call_back()
            return decide(observation)
        return policy.end_reason or action

    return decide


def _decide_once(policy: Policy, env: gymnasium.Env[Any, Any]) -> Callable[[Observation], np.ndarray | np.integer]:
    inner, name = lidar_env_of(env), type(policy).__name__
    outer: Any = env.unwrapped
    if isinstance(policy, ObservationPolicy):
        return policy if _chooses(env) else partial(_observe, policy, inner)
    if isinstance(policy, RuleExplorer) and _chooses(env):  # turn in place without candidates
        return lambda _: np.int64(policy.choose(outer.navigator, outer.belief) if len(outer.candidates) else 0)
    if not isinstance(policy, Explorer) or _chooses(env):
        raise ValueError(f"{name} outputs twists and cannot choose frontiers")
    is_team = len(inner.action_space.shape or ()) > 1
    if is_team != policy.is_team:
        hint = f"; OnePerRobot({name}()) drives each robot of a team separately" if is_team else ""
        raise ValueError(f"{name} drives {'one robot' if is_team else 'teams'}, but not {inner.action_space}{hint}")
    goal: Any = None

    def act(_: Observation) -> np.ndarray:
        nonlocal goal
        if inner.task.goal is not None and goal is not (told := inner.task.tell_goal(inner.belief.pose)):
            goal = told
            if inner.task.heading_tolerance is not None:
                policy.set_tolerances(inner.task.goal_tolerance, inner.task.heading_tolerance)
            policy.set_goal(goal)
        if is_team:
            readings: Any = [robot.reading for robot in inner.robots]
            beliefs: Any = [robot.belief for robot in inner.robots]
            twists: Any = policy.act(readings, beliefs)
            inner.overlay.plans[:] = policy.plans
            return np.stack([to_action(twist, inner.robot_params) for twist in twists])
        action = to_action(policy.act(inner.reading, inner.belief), inner.robot_params)
        inner.overlay.plan = policy.plan
        tracks = inner.belief.people if policy.tracks is None else policy.tracks
        inner.overlay.tracks = people_in(tracks, inner.belief.pose) if len(tracks) else NO_TRACKS
        return action

    return act


def _observe(policy: ObservationPolicy, inner: LidarEnv, observation: Observation) -> Any:
    action = policy(observation)
    inner.overlay.plans[:] = policy.plans
    return action


def _chooses(env: gymnasium.Env[Any, Any]) -> bool:
    return isinstance(env.action_space, spaces.Discrete)


def _repeats(policy: Policy, env: gymnasium.Env[Any, Any]) -> int:
    rate = policy.control_hz
    if rate is None or _chooses(env):
        return 1
    return max(1, round(1.0 / (rate * lidar_env_of(env).control_period)))


def prepare(env: gymnasium.Env[Any, Any], policy: Policy, seed: int, steps: int = 0) -> None:
    """Reset environment and policy, and run `steps` steps: a warm-up, or a check."""
    policy = adopt(policy, env.action_space)
    observation, info = begin_episode(env, policy, seed, np.random.default_rng(seed))
    run(env, decide_with(policy, env), observation, info, max_steps=steps)


def run_episode(env: gymnasium.Env[Any, Any], policy: Any, seed: int, on_step: Watch | None = None) -> Episode:
    """Run an episode and measure the policy's performance.

    Logs time, progress and `policy.status` (if any) every 10 s, at level INFO.

    Args:
        env: environment, possibly wrapped.
        policy: policy for one robot or a team, or what `lidarnaut.make_policy` accepts except for names. Only a
            `PrivilegedPolicy` receives ground truth.
        seed: seed of environment and policy.
        on_step: called with `info` after the reset and after every step.

    Raises:
        ValueError: if the policy is a name, or does not suit the environment.
    """
    policy = adopt(policy, env.action_space)
    inner, recorder = lidar_env_of(env), HistoryRecorder()
    # Independent of the generators that the environment spawns.
    observation, info = begin_episode(env, policy, seed, np.random.default_rng([seed, 1]))

    next_log = LOG_PERIOD if LOGGER.isEnabledFor(logging.INFO) else math.inf

    def watch(info: Info) -> None:
        nonlocal next_log
        recorder.watch(info)
        if info["time"] >= next_log:
            next_log += LOG_PERIOD
            what, status = inner.task.progress, policy.status
            who = type(policy).__name__, seed, info["time"]
            LOGGER.info("%s, seed %d, %.0f s: %s %.3f%s", *who, what, info[what], status and f", {status}")
        if on_step:
            on_step(info)

    decide = decide_with(policy, env)
    _, info, decision_times = run(env, decide, observation, info, watch, clock=time.process_time)
    history = recorder.history(info, inner.time_limit, inner.robot_params.max_v)
    return Episode(
        values={measure.name: float(measure.compute(history)) for measure in measures_of(inner.task.measures)},
        history=history,
        decision_times=np.array(decision_times),
        end_reason=info["end_reason"],
        duration=info["time"],
        time_limit=inner.time_limit,
        distance_limit=inner.robot_params.max_v * inner.time_limit,
    )
