"""Exploration at the level of decisions: choose a frontier, and the robot drives there."""

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lidarnaut.envs.arguments import check_positive, is_whole
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.drive import UNCHECKED, drive
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import (
    FEATURES,
    NUM_SECTORS,
    Candidates,
    FrontierNavigator,
    HomeNavigator,
    robot_features,
)
from lidarnaut.envs.observations import FAR_PIXEL, MapCrop
from lidarnaut.envs.robot import SCAN, Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.rows import BLOCK
from lidarnaut.envs.tasks.explore import Explore

MAX_CANDIDATES = 1000
"""Most candidates of a decision: the observation has a number for each pair of them."""
RESET, EPISODE_END = "reset", "episode_end"
"""Outcomes beside those of `FrontierNavigator`: there was no drive yet; the episode ended in the midst of one."""


class ExploreFrontiersEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """Explore an unknown world by choosing, again and again, the frontier to drive to.

    ## Description
    The world, the robot, its sensors and its SLAM are those of `Explore-v0`. The policy does not steer: each step it
    picks one of the frontiers (free cells of the map beside unknown ones) that the robot can get to. A navigator plans
    the path with each decision (and every four seconds of a longer one), follows it, keeps clear of what the lidar
    sees, and backs up when the robot gets nowhere.
    A step ends as soon as a new decision is due, after some control steps.

    ## Action Space
    `Discrete(max_candidates)`: the candidate to go to. Candidates come by increasing cost of the path, so 0 is the
    nearest one. `action_masks()` and `info["action_mask"]` tell which actions have a candidate. An action without one
    is no error: the last candidate is taken instead, and `info["action"]` says which.

    ## Observation Space
    `Dict`, as the robot sees it when the decision is due (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `candidates` | `Box(-1, 1, (max_candidates, 15), float32)` | a row per candidate; rows without one are 0 |
    | `sectors` | `Box(0, 1, (max_candidates, 48), float32)` | view from viewpoints: 24 free ranges, 24 unknown shares |
    | `gaps` | `Box(0, 1, (max_candidates, max_candidates), float32)` | distances between the candidates; h = 5 m |
    | `action_mask` | `MultiBinary(max_candidates)` | 1 for rows with a candidate |
    | `map` | `Box(0, 255, (3, 40, 40), uint8)` | map around the robot, as `map_far` of `Explore-v0` |
    | `robot` | `Box(0, 1, (3,), float32)` | range of the lidar, h = 10 m; radius, h = 0.5 m; speed, h = 1 m/s |

    Nothing tells the time or the size of the world. Lengths, areas and times without an end are given as x / (x + h).
    Views end at the lidar's range, and at 8 m; sectors go counter-clockwise from the direction in which most unknown
    area lies. Features of a candidate:

    | column | meaning |
    |---|---|
    | 0 `visible` | unknown area in view of the viewpoint, if nothing unknown blocks the view; h = 10 m2 |
    | 1 `unknown_1m`, 2 `unknown_2m`, 3 `unknown_4m` | share of the area around the frontier that is unknown |
    | 4 `cost` | length of the path, weighted by nearness to obstacles; h = 5 m |
    | 5 `cost_ratio` | 1 m and the cost of the cheapest, over 1 m and the cost of this one |
    | 6 `rank` | row, over `max_candidates` |
    | 7 `turn` | from the robot's heading to the beginning of the path, counter-clockwise, over pi |
    | 8 `size` | length of the frontier; h = 2 m |
    | 9 `clearance` | distance from obstacles at the viewpoint, over that from which they cost nothing |
    | 10 `age` | time for which there has been a candidate within 0.5 m, also while it moved on; h = 60 s |
    | 11 `ahead`, 12 `left` | where the frontier lies, in the robot's frame, over 16 m |
    | 13 `failures` | attempts to get here that failed, over the three after which it is no longer offered |
    | 14 `chosen` | 1 for the one nearest to the frontier that the last decision was for, and within 0.5 m of it |

    Frontiers longer than 2 m are split. If there are more than `max_candidates`, the cheapest to get to are offered.
    Frontiers that the robot has looked at from as near as it gets, and which are there still, are not offered again.

    ## Rewards
    The sum of `Explore-v0`'s reward over the control steps of the decision, term by term in `info["rewards"]`.

    ## Starting State
    As `Explore-v0`'s.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Termination: no frontier is left that the robot could get to, after it has looked around once more. The robot is
       stuck if no cell of its map near it is traversable, or it has not come ten centimetres far for half a minute.
    3. Truncation: `time_limit` seconds have passed; decisions are cut short.

    With `return_home=True` the navigator drives the robot back to its start in cases 1 and 2, within the same step, and
    the episode ends there: see `Explore-v0`.

    A decision is due when the robot has arrived, when its frontier is gone (and at least a second has passed), when it
    has not come half a metre far for ten seconds or there is no path any more, or when the drive has taken
    `max_decision_time`. A recovery is finished first, and looking around, where no frontier is left, comes
    on top: `decision_time` counts both. To go on to the same frontier, choose it again: `chosen` marks it.

    ## Information
    What `Explore-v0` gives, and each step: `action_mask` (int8), `action` (the candidate that was taken; -1 where there
    was none and the robot looked around), `outcome` (`"arrived"`, `"frontier_gone"`, `"failed"`, `"time_up"`,
    `"looked_around"`, `"episode_end"`; `"reset"` after one), `decision_time` [s], `decision_length` [m],
    `decision_steps` (control steps), `area_left` (explorable and unknown) [m2]. `end_reason` may also be
    `"no_reachable_frontier"` or `"stuck"`; with `return_home=True` instead `"arrived_home"` where the robot is back by
    its pose estimate, and in truth farther off than 0.3 m, or `"no_path_home"`.

    ## Arguments
    Those of `Explore-v0` but for `observations`, and

    | argument | default | meaning |
    |---|---|---|
    | `max_candidates` | `48` | frontiers that are offered at most |
    | `max_decision_time` | `4.0` | longest drive, but for recoveries and looking around [s] |
    | `control_hz` | `5.0` | control steps per second |

    ## Version History
    * v0: first version
    """

    metadata = LidarEnv.metadata
    task_kind: type[Explore] = Explore
    """The task that decisions are made for."""

    def __init__(
        self,
        *,
        max_candidates: int = 48,
        max_decision_time: float = 4.0,
        control_hz: float = 5.0,
        **arguments: Any,
    ) -> None:
        """See the class for the arguments; ValueError names one that is not allowed, and what is."""
        if not (is_whole(max_candidates) and 1 <= max_candidates <= MAX_CANDIDATES):
            raise ValueError(f"max_candidates must be whole and from 1 to {MAX_CANDIDATES:,}, got {max_candidates!r}")
        if "observations" in arguments:
            raise ValueError("observations cannot be chosen where actions are frontiers: see Observation Space")
        check_positive(max_decision_time=max_decision_time)
        self.explore = env = LidarEnv(self.task_kind, control_hz=control_hz, **arguments)
        """The environment that is driven. Control steps within a decision make no observations and no `info`."""
        self._task: Explore = env.task
        self.navigator = FrontierNavigator(
            env.robot, env.control_period, max_candidates=max_candidates, max_time=max_decision_time
        )
        self.render_mode = env.render_mode
        self.metadata = env.metadata
        self._max_candidates = max_candidates
        self._noted = np.empty((1, BLOCK, 4)), np.zeros((1, 2), dtype=np.int64)
        self._is_fused = False
        self._map = MapCrop(resolution=FAR_PIXEL)
        self.action_space = spaces.Discrete(max_candidates)
        self._robot_features = robot_features(env.robot)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                "candidates": spaces.Box(-1.0, 1.0, (max_candidates, len(FEATURES)), np.float32),
                "sectors": spaces.Box(0.0, 1.0, (max_candidates, 2 * NUM_SECTORS), np.float32),
                "gaps": spaces.Box(0.0, 1.0, (max_candidates, max_candidates), np.float32),
                "action_mask": spaces.MultiBinary(max_candidates),
                "map": self._map.space(env.robot),
                "robot": spaces.Box(0.0, 1.0, (3,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode and return the first observation and info; see `LidarEnv.reset`."""
        super().reset(seed=seed)
        explore = self.explore
        explore.begin(seed=seed, options=options)
        self._begin()
        self._is_fused = not self.why_not_fused
        self._steps, self._quantities = 0, dict.fromkeys(explore.task.rewards.weights, 0.0)
        self._path_length, self._taken, self._result = 0.0, -1, RESET
        self._home_reason: str | None = None
        return self.observe(), self._info()

    def step(self, action: np.int64) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive until the next decision is due.

        Raises:
            ValueError: if the action is not an integer from 0 to `max_candidates` - 1.
            gymnasium.error.ResetNeeded: if no episode has begun, or a step has failed.
        """
        self.apply(action)
        with self.explore.whole_step:
            return self.observe(), *self.outcome()

    def apply(self, action: Any) -> None:
        """Drive until the next decision is due, without an observation or outcome; raises as `step`."""
        self.explore.check_begun()
        if isinstance(action, np.ma.MaskedArray) or not self.action_space.contains(action):
            raise ValueError(f"action must be an integer from 0 to {self._max_candidates - 1}, got {action!r}")
        self._steps, self._quantities = 0, dict.fromkeys(self._quantities, 0.0)
        self._path_length = float(np.sum([truth.path_length for truth in self.explore.truths]))
        self._taken = min(int(action), len(self.candidates) - 1)
        with self.explore.whole_step:
            self._choose(self._taken)
            self._result = self._drive()
            is_explored = self._task.is_returning or len(self.candidates) == 0
            if self._task.return_home and is_explored and not any(self.explore.is_over):
                self._home_reason = self._drive_home()

    def outcome(self, is_last: bool = False) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of the last decision; see `LidarEnv.outcome`."""
        info = self._info()
        return self.explore.judge(info["rewards"], info, is_last, self._end_reason)

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return the observation in fresh arrays, or write it to the arrays of `out`, which may lack the `map`."""
        if out is None:
            spaces_ = self.observation_space.spaces  # type: ignore[attr-defined]
            out = {name: np.empty(space.shape, space.dtype) for name, space in spaces_.items()}
        self.navigator.write_features(self.belief.pose, out["candidates"], out["sectors"], out["gaps"])
        out["action_mask"][...] = self._mask()
        if "map" in out:
            self._map.write(self.deciding, out["map"])
        out["robot"][...] = self._robot_features
        return dict(out)

    def action_masks(self) -> np.ndarray:
        """Return which actions have a candidate, shape (max_candidates,), bool, as sb3-contrib's MaskablePPO asks."""
        return self._mask().astype(np.bool_)

    @property
    def candidates(self) -> Candidates:
        """What there is to choose from."""
        return self.navigator.candidates

    @property
    def deciding(self) -> Robot:
        """The robot whose decision is due."""
        return self.explore.robots[0]

    @property
    def belief(self) -> Belief:
        """Pose estimate and map of that robot."""
        return self.deciding.belief

    @property
    def robot(self) -> RobotParams:
        """The robot."""
        return self.explore.robot

    @property
    def time_limit(self) -> float:
        """Length of the episode at most [s]."""
        return self.explore.time_limit

    def prepare(self) -> None:
        """Draw the world of the next episode ahead of time; see `LidarEnv.prepare`."""
        self.explore.prepare()

    def render(self) -> np.ndarray | None:
        """Draw this moment; an array (height, width, 3), uint8, for `rgb_array`."""
        return self.explore.render()

    def close(self) -> None:
        """Release the physics engine and the window."""
        self.explore.close()

    @property
    def is_fused(self) -> bool:
        """Whether kernels drive for several control periods at once; False before the first reset."""
        return self._is_fused

    @property
    def why_not_fused(self) -> str:
        """Why control periods of this episode need Python one by one; empty where they do not."""
        env = self.explore
        if env.why_not_fused or not env.robots[0].follows_odometry:
            return env.why_not_fused or f"{type(env.robots[0].estimator).__name__} processes every scan"
        if not env.task.rests_between_scans:
            return f"task {type(env.task).__name__} looks at every control period"
        if env.sensors or env.on_period or env.render_mode == "human" or env.robots[0].tracker is not None:
            return "own sensors, trackers of people, recorders and windows look at every control period"
        return ""

    @property
    def _end_reason(self) -> str | None:
        """Why exploration is over though the task is not; None while it goes on."""
        return self._home_reason or (None if len(self.candidates) else self.navigator.end_reason)

    def _begin(self) -> None:
        """Find the first candidates."""
        self.navigator.begin(self.explore.reading, self.belief)

    def _choose(self, index: int) -> None:
        """Let the robot drive to a candidate; where there is none (-1), it looks around."""
        if index >= 0:
            self.navigator.choose(index)
        else:
            self.navigator.look_around()

    def _drive(self) -> str:
        """Drive until a decision is due, and return why."""
        while True:
            result = self._advance_fused() if self._is_fused else self._advance()
            if result is not None:
                self.explore.plan = self.navigator.plan
                return result

    def _advance(self) -> str | None:
        """Drive for one control period; return why a decision is due, if it is."""
        explore, navigator, robot = self.explore, self.navigator, self.explore.robots[0]
        explore.plan = navigator.plan
        self._control(navigator.command(robot.belief))
        if any(explore.is_over) or self._task.is_returning:
            navigator.look(robot.reading, robot.belief)
            return EPISODE_END
        return navigator.update(robot.reading, robot.belief)

    def _control(self, *twists: Twist) -> None:
        """Drive by a twist for each robot for one control period."""
        explore = self.explore
        if explore.render_mode == "human":
            explore.render()
        for robot, twist in zip(explore.robots, twists, strict=True):
            robot.action = twist.v / robot.params.max_v, twist.w / robot.params.max_w
        explore.advance(twists)
        self._note(1, 0)

    def _drive_home(self) -> str | None:
        """Drive back to the start; return why the drive ended before the episode did, if so."""
        explore, robot = self.explore, self.explore.robots[0]
        self._task.call_back()
        home = HomeNavigator(explore.robot, explore.control_period, explore.np_random)
        while not any(explore.is_over):
            twist = home.act(robot.reading, robot.belief)
            if home.home_reason is not None:
                break
            explore.plan = home.plan
            self._control(twist)
            self.navigator.integrate(robot.belief)
        self.navigator.look(robot.reading, robot.belief)
        return home.home_reason

    def _advance_fused(self) -> str | None:
        """Do the same for as many control periods as a kernel can do; the task processes the last one."""
        env, navigator = self.explore, self.navigator
        simulator, robot, truth, rows = env.simulator, env.robots[0], env.truths[0], env.rows
        left = math.ceil(min((env.time_limit - 1e-6) / env.control_period, 1e12)) - rows.steps  # may be inf
        rows.draw_ahead(simulator.rngs)
        around = env.world.segments, env.world.circles, simulator.crowd.arrays
        check_from = min(navigator.check_from, 1 << 40)
        arrays = rows.numbers, rows.draws, rows.ranges, around, navigator.navigator.arrays, self._noted
        count, progress, num_contacts = drive(*arrays, max(left, 1), check_from)
        v, w = rows.numbers[0, at.COMMAND_V : at.COMMAND_W + 1].tolist()
        robot.action = v / robot.params.max_v, w / robot.params.max_w
        navigator.navigator.velocity = robot.twist
        [positions], [[num_estimated, num_true]] = self._noted
        robot.trail.extend(positions[:num_estimated, :2])
        truth.trail.extend(positions[:num_true, 2:])
        for x, y in positions[:num_estimated, :2].tolist():
            robot.pyramid.mark(x, y)
        env.finish()
        self._note(count, num_contacts)
        reading, belief = robot.reading, robot.belief
        if int(rows.numbers[0, at.FLAGS]) & SCAN:
            navigator.integrate(belief)
        if any(env.is_over):
            navigator.find_candidates(reading, belief)
            return EPISODE_END
        if progress == UNCHECKED:
            progress = navigator.navigator.check_progress(belief.pose, bumper=reading.bumper)
        return navigator.conclude(progress, reading, belief)

    def _note(self, count: int, contacts: int) -> None:
        """Sum what is rewarded of `count` control periods, of which all but the last had `contacts` with something."""
        self._steps += count
        period, quantities = self.explore.control_period, self._quantities
        for name, quantity in self.explore.task.quantities().items():
            quantities[name] += quantity
        if count > 1:
            quantities["time"] += (count - 1) * period
            quantities["collision"] += contacts * period

    def _mask(self) -> np.ndarray:
        mask = np.zeros(self._max_candidates, dtype=np.int8)
        mask[: len(self.candidates)] = 1
        return mask

    def _info(self) -> dict[str, Any]:
        """Return the info of the exploration after a decision, with what there is to say of the decision."""
        explore = self.explore
        info = explore.info(explore.task.rewards.terms(self._quantities))
        return info | {
            "action_mask": self._mask(),
            "action": self._taken,
            "outcome": self._result,
            "decision_time": self._steps * explore.control_period,
            "decision_length": float(np.sum(info["path_length"])) - self._path_length,
            "decision_steps": self._steps,
            "area_left": self._task.coverage.area.area - info["explored_area"],
        }
