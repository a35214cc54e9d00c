"""Episodes: one loop that lets anything drive in any environment, and the measures of an exploration."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np

from envs.core import LidarEnv
from envs.navigation.home import HomeNavigator
from envs.tasks.coverage import map_iou

from .explorer import Explorer, ObservationPolicy, Omniscient, to_action

Info = dict[str, Any]
"""What an environment returns beside the observation."""
Observation = dict[str, np.ndarray]
"""What an environment returns to an explorer or a policy."""
Decide = Callable[[Observation], np.ndarray | np.integer | str]
"""Returns the action for an observation, or the reason to stop."""
Watch = Callable[[Info], None]
"""Is called with `info` after the reset and after every step."""


class Ended(NamedTuple):
    """How a loop ended."""

    observation: Observation
    info: Info
    """The last ones; `info` has an `end_reason`, unless `max_steps` ended the loop."""
    decision_times: list[float]
    """Time of each decision [s]."""


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
    """Step an environment until its episode ends, or `decide` returns a reason to stop.

    Args:
        env: the environment, after its reset.
        decide: decides.
        observation: of the reset, or of the last step.
        info: of the same.
        watch: called with `info` now and after every step, to take samples or pictures.
        max_steps: number of steps after which the loop ends all the same.
        clock: measures decisions [s].
    """
    decision_times: list[float] = []
    watch = watch or (lambda _: None)
    watch(info)
    while len(decision_times) < max_steps:
        began = clock()
        action = decide(observation)
        decision_times.append(clock() - began)
        if isinstance(action, str):
            return Ended(observation, {**info, "end_reason": action}, decision_times)
        observation, _, terminated, truncated, info = env.step(action)
        watch(info)
        if terminated or truncated:
            break
    return Ended(observation, info, decision_times)


def first_at(quantity: np.ndarray, fraction: np.ndarray, mark: float) -> float:
    """Return `quantity` (shape (n,)) where `fraction` (shape (n,)) first reaches `mark`; infinite if it never does."""
    reached = fraction >= mark
    return float(quantity[reached.argmax()]) if reached.any() else math.inf


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """The course of an episode, shape (n,), float64: one sample at the reset and one after every step."""

    time: np.ndarray
    """Since the reset [s]."""
    path_length: np.ndarray
    """True distance driven [m]."""
    explored_fraction: np.ndarray
    """Explored share of the explorable area."""


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """The measures of one episode, in simulated time and true distances.

    A mark that was never reached has infinite time and distance. Statistics that need a number take `time_limit` and
    `distance_limit` instead, so that ending early never counts as fast.
    """

    explored_fraction: float
    """Share of the explorable area that was explored at the end."""
    time_to_90: float
    time_to_95: float
    time_to_99: float
    """Times until 90, 95 and 99 % were explored [s]."""
    distance_to_95: float
    """Distance driven until 95 % was explored [m]."""
    area_under_curve: float
    """Mean explored fraction over the whole time limit; after an early end the last value holds."""
    path_length: float
    """Distance driven [m]."""
    collisions: int
    """Contacts begun."""
    position_rmse: float
    heading_rmse: float
    """Root mean square errors of the estimated position [m] and heading [rad]."""
    map_iou: float
    """Agreement of the map's occupied cells with the visible walls, from 0 to 1 (`envs.tasks.coverage.map_iou`)."""
    decision_ms: float
    """Mean processor time of a decision, of all threads [ms]: other processes of the machine do not count."""
    success: bool
    """Whether the environment's target coverage was reached."""
    end_reason: str
    """Why it ended: "covered", "returned", "time_limit", or why the explorer stopped ("no_reachable_frontier", ...)."""
    duration: float
    """Time at the end [s]."""
    time_limit: float
    """Time limit [s]."""
    distance_limit: float
    """Distance that the robot can drive within the time limit, at full speed [m]."""
    area_left: float
    """Explorable area that was not explored at the end [m2]."""
    curve: Curve
    """The explored fraction over time and distance."""


def exploration_of(env: gymnasium.Env[Any, Any]) -> LidarEnv:
    """Return the exploration in an environment, whatever wraps it, and be it driven by twists or by decisions."""
    return cast(LidarEnv, getattr(env.unwrapped, "explore", env.unwrapped))


def begin_episode(
    env: gymnasium.Env[Any, Any], explorer: Explorer | ObservationPolicy, seed: int, rng: np.random.Generator
) -> tuple[Observation, Info]:
    """Reset an environment by a seed, and then the explorer, which draws from `rng`; returns what the reset does.

    Only an `Omniscient` explorer gets ground truth.
    """
    inner = exploration_of(env)
    observation, info = env.reset(seed=seed)
    explorer.reset(inner.robot, inner.control_period, rng)
    if isinstance(explorer, Omniscient):
        explorer.reveal(inner.task.coverage, inner.task.target_coverage)
    return observation, info


def decide_with(explorer: Explorer | ObservationPolicy, env: LidarEnv) -> Decide:
    """Return the decisions of an explorer or a policy in an environment, which also gets its plan to draw.

    With `return_home=True` a navigator drives once the explorer has stopped, or the environment calls the robot back.
    """
    home = HomeNavigator(env.robot, env.control_period) if getattr(env.task, "return_home", False) else None

    def decide(observation: Observation) -> np.ndarray | np.integer | str:
        if home is not None and env.task.is_returning:
            twist = home.act(env.reading, env.belief)
            env.plan = home.plan
            return home.end_reason or to_action(twist, env.robot)
        action: np.ndarray | np.integer
        if hasattr(explorer, "act"):
            action = to_action(explorer.act(env.reading, env.belief), env.robot)
        else:
            action = explorer(observation)
        env.plan = explorer.plan
        if home is not None and explorer.end_reason is not None:
            env.task.call_back()
            return decide(observation)
        return explorer.end_reason or action

    return decide


def run_episode(
    env: gymnasium.Env[Any, Any], explorer: Explorer | ObservationPolicy, seed: int, on_step: Watch | None = None
) -> Episode:
    """Let an explorer explore until the target coverage or the time limit is reached, or the explorer stops.

    Args:
        env: an `ExploreEnv`, wrapped or not.
        explorer: decides; it gets readings and beliefs only, unless it is `Omniscient`.
        seed: of everything: world, start, noise, and the explorer's own draws.
        on_step: called with `info` after the reset and after every step, to record pictures.
    """
    inner = exploration_of(env)
    # The environment spawns its generators from the seed; the pair is a root of its own beside them.
    observation, info = begin_episode(env, explorer, seed, np.random.default_rng([seed, 1]))
    samples: list[tuple[float, ...]] = []

    def watch(info: Info) -> None:
        samples.append((info["time"], info["path_length"], info["explored_fraction"], *info["pose_error"]))
        if on_step:
            on_step(info)

    decide = decide_with(explorer, inner)
    _, info, decision_times = run(env, decide, observation, info, watch, clock=time.process_time)
    columns = np.array(samples)
    curve, limit = Curve(*columns[:, :3].T), inner.time_limit
    position_rmse, heading_rmse = np.sqrt(np.mean(columns[:, 3:] ** 2, axis=0))
    known = np.trapezoid(curve.explored_fraction, curve.time)
    known += curve.explored_fraction[-1] * max(0.0, limit - curve.time[-1])
    overlap = (
        info["map_iou"] if "map_iou" in info else map_iou(inner.belief.grid, inner.task.coverage.area, inner.map_pose)
    )
    return Episode(
        explored_fraction=info["explored_fraction"],
        time_to_90=first_at(curve.time, curve.explored_fraction, 0.90),
        time_to_95=first_at(curve.time, curve.explored_fraction, 0.95),
        time_to_99=first_at(curve.time, curve.explored_fraction, 0.99),
        distance_to_95=first_at(curve.path_length, curve.explored_fraction, 0.95),
        area_under_curve=float(known / max(limit, curve.time[-1])),
        path_length=info["path_length"],
        collisions=int(info["collisions"]),
        position_rmse=float(position_rmse),
        heading_rmse=float(heading_rmse),
        map_iou=float(overlap),
        decision_ms=1000.0 * float(np.mean(decision_times)),
        success=bool(info["is_success"]),
        end_reason=info["end_reason"],
        duration=info["time"],
        time_limit=limit,
        distance_limit=inner.robot.max_v * limit,
        area_left=inner.task.coverage.area.area - info["explored_area"],
        curve=curve,
    )
