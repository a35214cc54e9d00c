"""One explorer, one place, one seed: what came of it."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import gymnasium
import numpy as np

from envs.coverage import map_iou
from envs.explore import ExploreEnv

from .explorer import Explorer, ObservationPolicy, Omniscient, to_action


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """What was known when and where: one sample at the reset and one after every step."""

    time: np.ndarray
    """Shape (n,), float64, time since the reset [s]."""
    path_length: np.ndarray
    """Shape (n,), float64, distance driven in truth [m]."""
    explored_fraction: np.ndarray
    """Shape (n,), float64, truly known share of the explorable area."""


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """The measures of one episode, in simulated time and true distances.

    A mark that was never reached has infinite time and distance. Statistics that need a number take `time_limit` and
    `distance_limit` in their place, so that giving up early never looks quick.
    """

    explored_fraction: float
    """Truly known share of the explorable area at the end."""
    time_to_90: float
    """Time until 90 % was explored [s]; infinite if never."""
    time_to_95: float
    """Time until 95 % was explored [s]; infinite if never."""
    time_to_99: float
    """Time until 99 % was explored [s]; infinite if never."""
    distance_to_95: float
    """Distance driven until 95 % was explored [m]; infinite if never."""
    area_under_curve: float
    """Mean explored fraction over the whole time limit; after an early end the last value holds."""
    path_length: float
    """Distance driven [m]."""
    collisions: int
    """Contacts begun."""
    position_rmse: float
    """Root mean square error of the believed position [m]."""
    heading_rmse: float
    """Root mean square error of the believed heading [rad]."""
    map_iou: float
    """Agreement of the map's occupied cells with the visible walls, from 0 to 1 (`envs.coverage.map_iou`)."""
    decision_ms: float
    """Mean wall-clock time of a decision [ms]."""
    success: bool
    """Whether the environment's target coverage was reached."""
    end_reason: str
    """Why it ended: "covered" or "time_limit", or why the explorer stopped ("no_reachable_frontier", ...)."""
    duration: float
    """Time at the end [s]."""
    time_limit: float
    """Time that there was [s]."""
    distance_limit: float
    """Distance that the robot could have driven in that time at full speed [m]."""
    area_left: float
    """Explorable area that was still unknown at the end [m2]."""
    curve: Curve
    """The explored fraction over time and distance."""


def begin_episode(
    env: gymnasium.Env[Any, Any], explorer: Explorer | ObservationPolicy, seed: int, rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reset an environment and then the explorer; the truth is told to explorers that ask for it, and to no others.

    Args:
        env: an `ExploreEnv`, wrapped or not.
        explorer: will explore.
        seed: of the environment.
        rng: the explorer's source of chance.

    Returns:
        The environment's first observation and info.
    """
    place = cast(ExploreEnv, env.unwrapped)
    observation, info = env.reset(seed=seed)
    explorer.reset(place.robot, place.control_period, rng)
    if isinstance(explorer, Omniscient):
        explorer.reveal(place.coverage.area, place.start, place.target_coverage)
    return observation, info


def choose_action(
    explorer: Explorer | ObservationPolicy, env: ExploreEnv, observation: dict[str, np.ndarray]
) -> np.ndarray:
    """Return the action that an explorer or a policy takes now, shape (2,), float32."""
    if hasattr(explorer, "act"):
        return to_action(explorer.act(env.reading, env.belief), env.robot)
    return explorer(observation)


def run_episode(
    env: gymnasium.Env[Any, Any],
    explorer: Explorer | ObservationPolicy,
    seed: int,
    on_step: Callable[[dict[str, Any]], None] | None = None,
) -> Episode:
    """Let an explorer explore until the place is covered, the time is up, or the explorer stops.

    Args:
        env: an `ExploreEnv`, wrapped or not.
        explorer: decides; it sees observations and beliefs only, unless it is `Omniscient`.
        seed: of everything: place, start, noise, and the explorer's own draws.
        on_step: called with `info` after the reset and after every step, to record pictures.
    """
    place = cast(ExploreEnv, env.unwrapped)
    # The environment spawns its generators from the seed; the pair is a root of its own beside them.
    observation, info = begin_episode(env, explorer, seed, np.random.default_rng([seed, 1]))
    samples, errors, decision_time, decisions = [_sample(info)], [info["pose_error"]], 0.0, 0
    if on_step:
        on_step(info)
    while True:
        began = time.perf_counter()
        action = choose_action(explorer, place, observation)
        decision_time += time.perf_counter() - began
        decisions += 1
        if explorer.end_reason is not None:
            info = {**info, "end_reason": explorer.end_reason}
            break
        place.plan = explorer.plan
        observation, _, terminated, truncated, info = env.step(action)
        samples.append(_sample(info))
        errors.append(info["pose_error"])
        if on_step:
            on_step(info)
        if terminated or truncated:
            break
    if "map_iou" not in info:
        info["map_iou"] = map_iou(place.belief.grid, place.coverage.area, place.start)
    return _measure(place, info, Curve(*np.array(samples).T), np.array(errors), 1000.0 * decision_time / decisions)


def _sample(info: dict[str, Any]) -> tuple[float, float, float]:
    return info["time"], info["path_length"], info["explored_fraction"]


def _measure(place: ExploreEnv, info: dict[str, Any], curve: Curve, errors: np.ndarray, decision_ms: float) -> Episode:
    """Summarise an episode.

    Args:
        place: the environment, at the end of the episode.
        info: the last one, completed by `map_iou` and `end_reason`.
        curve: the samples.
        errors: shape (n, 2), position [m] and heading [rad].
        decision_ms: mean wall-clock time of a decision [ms].
    """
    limit = place.time_limit
    position_rmse, heading_rmse = np.sqrt(np.mean(errors**2, axis=0))
    known = np.trapezoid(curve.explored_fraction, curve.time)
    known += curve.explored_fraction[-1] * max(0.0, limit - curve.time[-1])
    return Episode(
        explored_fraction=info["explored_fraction"],
        time_to_90=_first(curve.time, curve, 0.90),
        time_to_95=_first(curve.time, curve, 0.95),
        time_to_99=_first(curve.time, curve, 0.99),
        distance_to_95=_first(curve.path_length, curve, 0.95),
        area_under_curve=float(known / max(limit, curve.time[-1])),
        path_length=info["path_length"],
        collisions=int(info["collisions"]),
        position_rmse=float(position_rmse),
        heading_rmse=float(heading_rmse),
        map_iou=float(info["map_iou"]),
        decision_ms=decision_ms,
        success=bool(info["is_success"]),
        end_reason=info["end_reason"],
        duration=info["time"],
        time_limit=limit,
        distance_limit=place.robot.max_v * limit,
        area_left=place.coverage.area.area - info["explored_area"],
        curve=curve,
    )


def _first(quantity: np.ndarray, curve: Curve, mark: float) -> float:
    """Return `quantity` where the curve first reaches `mark`, and infinity if it never does."""
    reached = curve.explored_fraction >= mark
    return float(quantity[reached.argmax()]) if reached.any() else math.inf
