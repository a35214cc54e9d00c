"""Drives to a goal on a known map, and their measures."""

from dataclasses import dataclass

import numpy as np

from baselines.episode import Decide, Info, Observation, Watch, run
from baselines.explorer import to_action
from baselines.navigation.map_navigator import MapNavigator
from baselines.navigation.params import DEFAULTS, MapNavigatorParams
from envs.core import LidarEnv


@dataclass(frozen=True, slots=True)
class Drive:
    """The measures of one drive, in simulated time and true distances."""

    seed: int
    """Of everything random."""
    end_reason: str
    """"reached" (by the true pose), "time_limit", "refused" (the navigator rejects the goal), "elsewhere" (only the
    estimated position is at the goal), or why the navigator failed."""
    collisions: int
    """Contacts begun."""
    duration: float
    """Time at the end [s]."""
    geodesic_distance: float
    """True geodesic distance to the goal at the start [m]."""
    path_length: float
    """Distance driven [m]."""
    position_rmse: float
    heading_rmse: float
    """Root mean square errors of the estimated position [m] and heading [rad]."""
    recoveries: int
    """Number of recovery behaviors."""
    control_us: float
    """Median wall-clock time of a decision [us]."""
    plan_ms: float
    """Wall-clock time of the first decision, which plans [ms]."""

    @property
    def is_success(self) -> bool:
        """Whether the goal was reached without a collision."""
        return self.end_reason == "reached" and self.collisions == 0


def make_navigator(env: LidarEnv, seed: int, params: MapNavigatorParams = DEFAULTS) -> MapNavigator:
    """Return a navigator for an environment after its reset."""
    # The environment spawns its generators from the seed; the pair is a root of its own beside them.
    return MapNavigator(env.robot, env.control_period, env.belief.grid, np.random.default_rng([seed, 1]), params)


def decide_with_navigator(navigator: MapNavigator, env: LidarEnv) -> Decide:
    """Return the decisions of a navigator in an environment, which also gets its plan to draw.

    The environment ends the episode when the true pose is at the goal, so a navigator that says so first is elsewhere.
    """

    def decide(observation: Observation) -> np.ndarray | str:
        action = to_action(navigator.act(env.reading, env.belief), env.robot)
        env.plan = navigator.plan
        return "elsewhere" if navigator.end_reason == "reached" else navigator.end_reason or action

    return decide


def drive(env: LidarEnv, seed: int, params: MapNavigatorParams = DEFAULTS, on_step: Watch | None = None) -> Drive:
    """Reset an environment and drive until the goal or the time limit is reached, or the navigator fails.

    The seed is that of everything; `on_step` is called with `info` after the reset and after every step.
    """
    observation, info = env.reset(seed=seed)
    distance, errors, decision_times = info["way_to_goal"], list[np.ndarray](), [0.0]
    navigator = make_navigator(env, seed, params)

    def watch(info: Info) -> None:
        errors.append(info["pose_error"])
        if on_step:
            on_step(info)

    try:
        navigator.set_goal(env.task.goal[:2])
    except ValueError:
        watch(info)
        info = {**info, "end_reason": "refused"}
    else:
        _, info, decision_times = run(env, decide_with_navigator(navigator, env), observation, info, watch)
    position, heading = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
    return Drive(
        seed=seed,
        end_reason=info["end_reason"],
        collisions=int(info["collisions"]),
        duration=info["time"],
        geodesic_distance=distance,
        path_length=info["path_length"],
        position_rmse=position,
        heading_rmse=heading,
        recoveries=navigator.num_recoveries,
        control_us=1e6 * float(np.median(decision_times)),
        plan_ms=1e3 * decision_times[0],
    )
