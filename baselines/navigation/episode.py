"""One drive to a goal on a known map: what came of it."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.navigation.map_navigator import DEFAULTS, MapNavigator, MapNavigatorParams
from envs.navigate import NavigateEnv


@dataclass(frozen=True, slots=True)
class Drive:
    """The measures of one drive, in simulated time and true distances."""

    seed: int
    """Of everything random."""
    end_reason: str
    """"reached" (truly), "time_limit", "refused" (the navigator does not accept the goal), "elsewhere" (the navigator
    believes to be there and is not), or why the navigator gave up."""
    collisions: int
    """Contacts begun."""
    duration: float
    """Time at the end [s]."""
    way: float
    """True way to the goal at the start [m]."""
    path_length: float
    """Distance driven [m]."""
    position_rmse: float
    """Root mean square error of the believed position [m]."""
    heading_rmse: float
    """The same of the heading [rad]."""
    recoveries: int
    """How often the navigator had to free the robot."""
    control_us: float
    """Median wall-clock time of a decision [us]."""
    plan_ms: float
    """Wall-clock time of the first decision, which plans [ms]."""

    @property
    def is_success(self) -> bool:
        """Whether the goal was reached without a collision."""
        return self.end_reason == "reached" and self.collisions == 0


def make_navigator(env: NavigateEnv, seed: int, params: MapNavigatorParams = DEFAULTS) -> MapNavigator:
    """Return a navigator for an environment after its reset."""
    # The environment spawns its generators from the seed; the pair is a root of its own beside them.
    return MapNavigator(env.robot, env.control_period, env.belief.grid, np.random.default_rng([seed, 1]), params)


def drive(
    env: NavigateEnv,
    seed: int,
    params: MapNavigatorParams = DEFAULTS,
    on_step: Callable[[NavigateEnv], None] | None = None,
) -> Drive:
    """Reset an environment and let the navigator drive until the goal is reached, the time is up, or it gives up.

    Args:
        env: the environment, without wrappers.
        seed: of everything.
        params: of the navigator.
        on_step: called after the reset and after every step, to record pictures.
    """
    observation, info = env.reset(seed=seed)
    way = info["way_to_goal"]
    navigator = make_navigator(env, seed, params)
    errors, decisions = [info["pose_error"]], list[float]()
    try:
        navigator.set_goal(env.goal[:2])
    except ValueError:
        return _measure(seed, "refused", info, way, errors, navigator, [0.0])
    if on_step:
        on_step(env)
    reason = ""
    while not reason:
        observation, info, reason = step(env, navigator, observation, decisions)
        errors.append(info["pose_error"])
        if on_step:
            on_step(env)
    return _measure(seed, reason, info, way, errors, navigator, decisions)


def step(
    env: NavigateEnv, navigator: MapNavigator, observation: dict[str, np.ndarray], decisions: list[float]
) -> tuple[dict[str, np.ndarray], dict[str, Any], str]:
    """Let the navigator decide, and the environment follow.

    Args:
        env: the environment.
        navigator: decides.
        observation: the last one.
        decisions: the wall-clock time of the decision is appended [s].

    Returns:
        Observation, info, and why the drive has ended; "" while it has not.
    """
    began = time.perf_counter()
    action = navigator.act(observation, env.belief)
    decisions.append(time.perf_counter() - began)
    env.plan = navigator.plan
    observation, _, terminated, truncated, info = env.step(action)
    if terminated or truncated:
        return observation, info, info["end_reason"]
    reason = navigator.end_reason or ""
    return observation, info, "elsewhere" if reason == "reached" else reason


def _measure(
    seed: int,
    reason: str,
    info: dict[str, Any],
    way: float,
    errors: list[np.ndarray],
    navigator: MapNavigator,
    decisions: list[float],
) -> Drive:
    position, heading = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
    return Drive(
        seed=seed,
        end_reason=reason,
        collisions=int(info["collisions"]),
        duration=info["time"],
        way=way,
        path_length=info["path_length"],
        position_rmse=position,
        heading_rmse=heading,
        recoveries=navigator.num_recoveries,
        control_us=1e6 * float(np.median(decisions)),
        plan_ms=1e3 * decisions[0],
    )
