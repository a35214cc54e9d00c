"""Exploration environment with actions that choose frontiers."""

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lidarnaut.envs.arguments import check_positive, is_whole
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation import (
    FEATURES,
    NUM_SECTORS,
    Candidates,
    FrontierNavigator,
    HomeNavigator,
    Markers,
    robot_features,
)
from lidarnaut.envs.navigation.controllers.navigator_kernels import DRIVING, FAILED, REACHED, SPUN, TIME_UP
from lidarnaut.envs.observations import FAR_PIXEL, MapCrop
from lidarnaut.envs.robot import SCAN, Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.simulation.slide import DRIVEN, Slide
from lidarnaut.envs.task import COLUMNS
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.transition import UNCHECKED

MAX_CANDIDATES = 1000
"""Upper limit of the argument `max_candidates`: observations contain distances between all candidates."""
RESET, EPISODE_END = "reset", "episode_end"
STILL = np.zeros((1, 2))


class ExploreFrontiersEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """Explore an unknown world by repeatedly choosing the frontier to drive to.

    ## Description
    World, robot, sensors and SLAM are those of `Explore-v0`. In each step, the policy chooses a reachable frontier
    (free map cells next to unknown cells). A navigator plans the path, again every four seconds, avoids obstacles in
    the scan, and recovers if the robot is blocked. The step ends when the next decision is due.

    ## Action Space
    `Discrete(max_candidates)`: index of a candidate, by increasing path cost. `action_masks()` and
    `info["action_mask"]` mark valid actions. An invalid action selects the last candidate.

    ## Observation Space
    `Dict` of new arrays:

    | key | space | meaning |
    |---|---|---|
    | `candidates` | `Box(-1, 1, (max_candidates, 15), float32)` | one row per candidate; unused rows are 0 |
    | `sectors` | `Box(0, 1, (max_candidates, 48), float32)` | view from viewpoints: 24 free ranges, 24 unknown shares |
    | `gaps` | `Box(0, 1, (max_candidates, max_candidates), float32)` | distances between candidates; h = 5 m |
    | `action_mask` | `MultiBinary(max_candidates)` | 1 for valid candidates |
    | `map` | `Box(0, 255, (3, 40, 40), uint8)` | map around the robot, as `map_far` of `Explore-v0` |
    | `robot` | `Box(0, 1, (3,), float32)` | lidar range, h = 10 m; radius, h = 0.5 m; maximum speed, h = 1 m/s |

    Unbounded quantities x are scaled to x / (x + h). Views are limited to the lidar range and 8 m. Sectors run
    counter-clockwise from the direction with most unknown area. Candidate features:

    | column | meaning |
    |---|---|
    | 0 `visible` | unknown area visible from the viewpoint, through unknown cells; h = 10 m2 |
    | 1 `unknown_1m`, 2 `unknown_2m`, 3 `unknown_4m` | unknown fraction of the area around the frontier |
    | 4 `cost` | path length, weighted by proximity to obstacles; h = 5 m |
    | 5 `cost_ratio` | (lowest cost + 1 m) / (cost + 1 m) |
    | 6 `rank` | row / `max_candidates` |
    | 7 `turn` | angle from heading to path start, counter-clockwise, / pi |
    | 8 `size` | frontier length; h = 2 m |
    | 9 `clearance` | obstacle distance of the viewpoint / distance without obstacle cost |
    | 10 `age` | time with a candidate within 0.5 m, tracked as it moves; h = 60 s |
    | 11 `ahead`, 12 `left` | frontier position, base frame / 16 m |
    | 13 `failures` | failed attempts / 3, the limit |
    | 14 `chosen` | 1 for the candidate nearest to the previous choice, within 0.5 m |

    Frontiers longer than 2 m are split. The `max_candidates` cheapest are offered. A frontier that remains after the
    robot has observed it from the closest viewpoint is excluded.

    ## Rewards
    Sum of the `Explore-v0` reward over the control steps of the decision; terms are in `info["rewards"]`.

    ## Starting State
    As in `Explore-v0`.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Termination: no reachable frontier is left after a turn in place. The robot is stuck if no map cell near it is
       traversable, or if it has moved less than 0.1 m in 30 s.
    3. Truncation: `time_limit` seconds have passed, also during a decision.

    With `return_home=True`, the navigator drives back to the start in cases 1 and 2, within the same step: see
    `Explore-v0`.

    A decision is due when the robot arrives, when its frontier disappears (after one second at the earliest), when it
    has moved less than 0.5 m in 10 s, when no path is left, or after `max_decision_time`. Choose the candidate marked
    `chosen` to continue.

    ## Information
    As in `Explore-v0`, and each step: `action_mask` (int8), `action` (selected candidate, or -1 for a turn in place),
    `outcome` (`"arrived"`, `"frontier_gone"`, `"failed"`, `"time_up"`, `"looked_around"`, `"episode_end"`, `"reset"`),
    `decision_time` [s], `decision_length` [m], `decision_steps` (control steps), `area_left` (explorable and unknown)
    [m2]. Further `end_reason`: `"no_reachable_frontier"`, `"stuck"`; with `return_home=True` instead `"no_path_home"`,
    or `"arrived_home"` if the robot is home by its estimate but truly more than 0.3 m away.

    ## Arguments
    As in `Explore-v0`, without `observations`, `clip_actions` and `cost`, and

    | argument | default | meaning |
    |---|---|---|
    | `max_candidates` | `48` | maximum number of offered frontiers |
    | `max_decision_time` | `4.0` | maximum drive time, without recoveries and turns in place [s] |
    | `control_hz` | `5.0` | control steps per second |
    | `physics` | `"bullet"` | also `"slide"`: the robot slides along its path, see `ExploreFrontiersAbstract-v0` |

    ## Version History
    * v0: first version
    """

    metadata = LidarEnv.metadata
    task_kind: type[Explore] = Explore
    """Class of the exploration task."""
    ignores: Mapping[str, str] = dict.fromkeys(("observations", "clip_actions", "cost"), "lidarnaut/Explore-v0")
    """Arguments that have no effect here, and are refused: the id of an environment that honours each."""

    def __init__(
        self, *, max_candidates: int = 48, max_decision_time: float = 4.0, control_hz: float = 5.0, **arguments: Any
    ) -> None:
        if not (is_whole(max_candidates) and 1 <= max_candidates <= MAX_CANDIDATES):
            raise ValueError(f"max_candidates must be an integer from 1 to {MAX_CANDIDATES:,}, got {max_candidates!r}")
        check_positive(max_decision_time=max_decision_time)
        ignores = dict(self.ignores)
        if arguments.get("physics") == "slide" and not self.task_kind.is_team:
            arguments = {"slam": "truth", "map_resolution": 0.2, **arguments, "physics": Slide}
            ignores |= Slide.ignores
            if arguments["slam"] != "truth":
                raise ValueError(f"slam must be 'truth' in slides, got {arguments['slam']!r}")
            if others := [name for name in arguments.get("randomize") or () if not name.startswith("lidar.")]:
                raise ValueError(f"randomize must name only lidar parameters in slides, got {others}")
        for name, advice in ignores.items():
            if arguments.get(name):
                raise ValueError(f"argument {name!r} has no effect in {type(self).__name__}; choose {advice}")
        self.explore = env = LidarEnv(self.task_kind, control_hz=control_hz, **arguments)
        """Underlying environment with velocity commands. Its observations are not used."""
        self._task: Explore = env.task
        if self._slides and (unknown := [name for name in env.task.rewards.shared if name in COLUMNS]):
            raise ValueError(f"reward terms {unknown} have no effect in slides; choose {DRIVEN}")
        self._limits: Any = {"max_candidates": max_candidates, "max_time": max_decision_time}
        self.navigator = FrontierNavigator(env.robot_params, env.control_period, **self._limits)
        self.render_mode = env.render_mode
        self.metadata = env.metadata
        self._max_candidates = max_candidates
        self.is_fused = False
        """Whether one kernel call simulates several control periods."""
        self._map = MapCrop(resolution=FAR_PIXEL)
        self.action_space = spaces.Discrete(max_candidates)
        self._robot_features = robot_features(env.robot_params)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                "candidates": spaces.Box(-1.0, 1.0, (max_candidates, len(FEATURES)), np.float32),
                "sectors": spaces.Box(0.0, 1.0, (max_candidates, 2 * NUM_SECTORS), np.float32),
                "gaps": spaces.Box(0.0, 1.0, (max_candidates, max_candidates), np.float32),
                "action_mask": spaces.MultiBinary(max_candidates),
                "map": self._map.space(env.robot_params),
                "robot": spaces.Box(0.0, 1.0, (3,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        super().reset(seed=seed)
        explore = self.explore
        explore.begin(seed=seed, options=options)
        self._begin()
        if self._slides:
            explore.simulator.area = self._task.coverage.area
            # Scan obstacles do not move with the robot here: plan on the map only.
            record = self.navigator.navigator.record
            record["num_remembered"] = record["num_seen"] = record["num_obstacles"] = 0
        self.is_fused = not self.why_not_fused
        self._steps, self._rewards = 0, dict.fromkeys(explore.task.rewards.weights, 0.0)
        self._path_length, self._taken, self._result = 0.0, -1, RESET
        self._home_reason: str | None = None
        return self.observe(), self._info()

    def step(self, action: np.int64) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive to the chosen frontier until the next decision is due.

        Raises:
            ValueError: if the action is not an integer from 0 to `max_candidates` - 1.
            gymnasium.error.ResetNeeded: if no episode has begun, or a step has failed.
        """
        self.apply(action)
        try:
            return self.observe(), *self.outcome()
        except BaseException:
            self.explore.has_begun = False
            raise

    def apply(self, action: Any) -> None:
        self.explore.check_begun()
        if isinstance(action, np.ma.MaskedArray) or not self.action_space.contains(action):
            raise ValueError(f"action must be an integer from 0 to {self._max_candidates - 1}, got {action!r}")
        self._steps, self._rewards = 0, dict.fromkeys(self.explore.task.rewards.weights, 0.0)
        self._path_length = float(np.sum([truth.path_length for truth in self.explore.truths]))
        self._taken = min(int(action), len(self.candidates) - 1)
        try:
            self._choose(self._taken)
            self._result = self._drive()
            is_explored = self._task.is_returning or len(self.candidates) == 0
            if self._task.return_home and is_explored and not any(self.explore.is_over):
                self._home_reason = self._drive_home()
        except BaseException:
            self.explore.has_begun = False
            raise

    def outcome(self, is_last: bool = False) -> tuple[float, bool, bool, dict[str, Any]]:
        info = self._info()
        return self.explore.judge(info["rewards"], info, is_last, self._end_reason)

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return the observation in new arrays or in those of `out`; without `map` if `out` lacks it."""
        if out is None:
            spaces_ = self.observation_space.spaces  # type: ignore[attr-defined]
            out = {name: np.empty(space.shape, space.dtype) for name, space in spaces_.items()}
        self.navigator.write_features(self.belief.pose, out["candidates"], out["sectors"], out["gaps"])
        out["action_mask"][...] = self._mask()
        if "map" in out:
            rows = self.explore.period.rows
            self._map.write(*((rows, out["map"][None]) if len(rows.robots) == 1 else (self.deciding, out["map"])))
        out["robot"][...] = self._robot_features
        return dict(out)

    def action_masks(self) -> np.ndarray:
        """Return the mask of valid actions for `MaskablePPO`, shape (max_candidates,), bool."""
        return self._mask().astype(np.bool_)

    @property
    def candidates(self) -> Candidates:
        """Frontiers that the policy may choose in the current decision."""
        return self.navigator.candidates

    @property
    def deciding(self) -> Robot:
        """Robot that the current decision is for; teams decide for one robot at a time."""
        return self.explore.robots[0]

    @property
    def belief(self) -> Belief:
        """Pose estimate and map of the robot that the current decision is for."""
        return self.deciding.belief

    @property
    def robot_params(self) -> RobotParams:
        """Nominal robot parameters, also as `robot`."""
        return self.explore.robot_params

    robot = robot_params

    @property
    def time_limit(self) -> float:
        return self.explore.time_limit

    def prepare(self) -> None:
        self.explore.prepare()

    def set_options(self, options: Mapping[str, Any] | None) -> None:
        """Set options of `reset` for all further episodes; see `LidarEnv.set_options`."""
        self.explore.set_options(options)

    def render(self) -> np.ndarray | None:
        return self.explore.render()

    def close(self) -> None:
        self.explore.close()

    @property
    def _slides(self) -> bool:
        return isinstance(self.explore.simulator, Slide)

    @property
    def why_not_fused(self) -> str:
        """Reason why one kernel call cannot simulate several control periods; empty if it can."""
        env = self.explore
        if env.why_not_fused or not env.robots[0].estimator.follows_odometry:
            return env.why_not_fused or f"{type(env.robots[0].estimator).__name__} processes every scan"
        if not env.task.rests_between_scans:
            return f"task {type(env.task).__name__} needs every control period"
        own = env.sensors or env.task.rewards.reads_shared or env.period.monitor or env.robots[0].tracker
        if own or env.on_period or env.render_mode == "human":
            return "sensors, rewarded speeds, monitors, trackers, recorders and windows need every control period"
        return ""

    @property
    def _end_reason(self) -> str | None:
        return self._home_reason or (None if len(self.candidates) else self.navigator.end_reason)

    def _begin(self) -> None:
        self.navigator.begin(self.explore.reading, self.belief)
        self.explore.overlay.markers = partial(Markers.of, [self.navigator])

    def _choose(self, index: int) -> None:
        if index >= 0:
            self.navigator.choose(index)
        else:
            self.navigator.look_around()

    def _drive(self) -> str:
        advance = self._slide if self._slides else self._advance_fused if self.is_fused else self._advance
        while True:
            self.explore.overlay.plan = self.navigator.plan
            result = advance()
            if result is not None:
                self.explore.overlay.plan = self.navigator.plan
                return result

    def _advance(self) -> str | None:
        explore, navigator, robot = self.explore, self.navigator, self.explore.robots[0]
        self._control(navigator.command(robot.belief))
        if any(explore.is_over) or self._task.is_returning:
            navigator.look(robot.reading, robot.belief)
            return EPISODE_END
        return navigator.update(robot.reading, robot.belief)

    def _control(self, *twists: Twist) -> None:
        period = self.explore.period
        period.run(period.follow(np.array(twists)))
        self._note(1, 0)

    def _drive_home(self) -> str | None:
        explore, robot = self.explore, self.explore.robots[0]
        self._task.call_back()
        home = HomeNavigator(explore.robot_params, explore.control_period, explore.np_random)
        while not any(explore.is_over):
            twist = home.act(robot.reading, robot.belief)
            if home.home_reason is not None:
                break
            explore.overlay.plan = home.plan
            self._control(twist)
            self.navigator.integrate(robot.belief)
        self.navigator.look(robot.reading, robot.belief)
        return home.home_reason

    def _advance_fused(self) -> str | None:
        env, navigator, robot = self.explore, self.navigator, self.explore.robots[0]
        count, progress, num_contacts = env.period.drive(navigator.navigator, navigator.check_from)
        self._note(count, num_contacts)
        reading, belief = robot.reading, robot.belief
        if int(env.rows.numbers["pending"][0]) & SCAN:
            navigator.integrate(belief)
        if any(env.is_over):
            navigator.find_candidates(reading, belief)
            return EPISODE_END
        if progress == UNCHECKED:
            progress = navigator.navigator.check_progress(belief.pose, bumper=reading.bumper)
        return navigator.conclude(progress, reading, belief)

    def _slide(self) -> str | None:
        env, navigator, robot = self.explore, self.navigator, self.explore.robots[0]
        for pose, count, progress in self._spin() if navigator.plan is None else self._stops(navigator.plan):
            env.simulator.aim(pose, count)
            env.period.run(STILL)
            self._note(count, 0)
            navigator.integrate(robot.belief)
            if any(env.is_over):
                navigator.find_candidates(robot.reading, robot.belief)
                return EPISODE_END
            progress = FAILED if env.simulator.is_blocked else progress
            result = navigator.conclude(progress, robot.reading, robot.belief)
            if result is not None:
                return result
        return None

    def _stops(self, plan: np.ndarray) -> Iterator[tuple[Pose2D, int, int]]:
        """Yield estimated pose, control periods and progress of each scan on a planned path."""
        navigator, before = self.navigator.navigator, 0
        max_steps, sees_around = int(navigator.numbers["max_steps"]), bool(navigator.numbers["sees_around"])
        stops, is_end = self.explore.simulator.stops(self.belief.pose, plan, max_steps)
        *others, last = stops
        for x, y, heading, count in others:
            navigator.record["steps"] = count
            yield Pose2D(x, y, wrap_angle(heading)), count - before, DRIVING
            before = count
        x, y, heading, count = last
        navigator.record["steps"] = count
        if is_end and not sees_around:
            target = self.navigator.target or (x, y)
            heading = math.atan2(target[1] - y, target[0] - x) - self.robot_params.lidar.mount.yaw
        yield Pose2D(x, y, wrap_angle(heading)), count - before, REACHED if is_end else TIME_UP

    def _spin(self) -> Iterator[tuple[Pose2D, int, int]]:
        """Yield estimated pose, control periods and progress of each scan of a turn in place."""
        navigator, (x, y, theta) = self.navigator.navigator, self.belief.pose
        navigator.stop()
        parts = (
            1 if navigator.numbers["sees_around"] else max(4, math.ceil(2.0 * math.pi / self.robot_params.lidar.fov))
        )
        count = math.ceil(2.0 * math.pi / float(navigator.numbers["spin_rate"]) / self.explore.control_period / parts)
        for k in range(parts):
            heading = wrap_angle(theta + 2.0 * math.pi * (k + 1) / parts)
            yield Pose2D(x, y, heading), count, SPUN if k == parts - 1 else DRIVING

    def _note(self, count: int, contacts: int) -> None:
        self._steps += count
        if self.render_mode == "human":
            self.render()
        for name, term in self.explore.period.reward_terms(count, contacts).items():
            self._rewards[name] = self._rewards.get(name, 0.0) + term

    def _mask(self) -> np.ndarray:
        mask = np.zeros(self._max_candidates, dtype=np.int8)
        mask[: len(self.candidates)] = 1
        return mask

    def _info(self) -> dict[str, Any]:
        explore = self.explore
        return explore.info(self._rewards) | {
            "action_mask": self._mask(),
            "action": self._taken,
            "outcome": self._result,
            "decision_time": self._steps * explore.control_period,
            "decision_length": float(np.sum([truth.path_length for truth in explore.truths])) - self._path_length,
            "decision_steps": self._steps,
            "area_left": self._task.coverage.area.area - self._task.coverage.explored_area,
        }
