"""Exploration at the level of decisions: choose a frontier, and the robot drives there."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from envs.compilation import announce_compilation
from envs.coverage import map_iou
from envs.explore import ExploreEnv
from envs.frontier_choice import DRIVING, FEATURES, OUTCOMES, OVER, RESET, FrontierChoice, act, judge
from envs.frontier_choice.candidates import find_candidates
from envs.geometry import OccupancyGrid, Pose2D
from envs.map_pyramid import CROP_SIZE
from envs.robot_env import check_positive


def make_choice(explore: ExploreEnv, max_candidates: int, max_decision_time: float) -> FrontierChoice:
    """Return the choice between frontiers for the robot of an environment.

    Raises:
        ValueError: if `max_candidates` or `max_decision_time` is not positive.
    """
    if max_candidates < 1:
        raise ValueError(f"max_candidates must be at least 1, got {max_candidates}")
    check_positive(max_decision_time=max_decision_time)
    announce_compilation(find_candidates)
    return FrontierChoice(
        explore.robot,
        explore.control_period,
        explore.resolution,
        explore.robot.lidar.directions,
        max_candidates=max_candidates,
        max_time=max_decision_time,
    )


def candidates_space(max_candidates: int) -> spaces.Dict:
    """Return the observation space of `ExploreFrontiersEnv`."""
    return spaces.Dict(
        {
            "candidates": spaces.Box(-1.0, 1.0, (max_candidates, len(FEATURES)), np.float32),
            "action_mask": spaces.MultiBinary(max_candidates),
            "map": spaces.Box(0, 255, (3, CROP_SIZE, CROP_SIZE), np.uint8),
            "motion": spaces.Box(-1.0, 1.0, (6,), np.float32),
        }
    )


class ExploreFrontiersEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """Explore an unknown place by choosing, again and again, the frontier to drive to.

    ## Description
    The place, the robot, its sensors and its SLAM are those of `ExploreEnv`. The policy does not steer: each step it
    picks one of the frontiers (free cells of the map beside unknown ones) that the robot can get to. A pilot plans the
    way with each decision (and every four seconds of a longer one), follows it, keeps clear of what the lidar sees, and
    backs off when it is caught.
    A step ends as soon as a new decision is due, after some control steps.

    ## Action Space
    `Discrete(max_candidates)`: the candidate to go to. Candidates come by increasing cost of the way, so 0 is the
    nearest one. `action_masks()` and `info["action_mask"]` tell which actions have a candidate. An action without one
    is no error: the last candidate is taken instead, and `info["action"]` says which.

    ## Observation Space
    `Dict`, as the robot sees it when the decision is due (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `candidates` | `Box(-1, 1, (max_candidates, 10), float32)` | a row per candidate; rows without one are 0 |
    | `action_mask` | `MultiBinary(max_candidates)` | 1 for rows with a candidate |
    | `map` | `Box(0, 255, (3, 40, 40), uint8)` | believed map around the robot, as `map_far` of `ExploreEnv` |
    | `motion` | `Box(-1, 1, (6,), float32)` | as `ExploreEnv`'s |

    Features of a candidate, with x / (x + h) for lengths, costs and times without an end:

    | column | meaning |
    |---|---|
    | 0 `gain` | share of the area within 1 m of the frontier that is unknown |
    | 1 `cost` | length of the way, weighted by nearness to obstacles; h = 5 m |
    | 2 `turn` | from the robot's heading to the beginning of the way, counter-clockwise, over pi |
    | 3 `size` | length of the frontier; h = 2 m |
    | 4 `clearance` | distance from obstacles at the end of the way, over that from which they cost nothing |
    | 5 `age` | time for which there has been a candidate within 0.5 m, also while it moved on; h = 60 s |
    | 6 `ahead`, 7 `left` | where the frontier lies, in the robot's frame, over 16 m |
    | 8 `failures` | attempts to get here that failed, over the three after which it is no longer offered |
    | 9 `chosen` | 1 for the one nearest to the frontier that the last decision was for, and within 0.5 m of it |

    Frontiers longer than 2 m are split. If there are more than `max_candidates`, the cheapest to get to are offered.
    Frontiers that the robot has looked at from as near as it gets, and which are there still, are not offered again.

    ## Rewards
    The sum of `ExploreEnv`'s reward over the control steps of the decision, term by term in `info["rewards"]`.

    ## Starting State
    As `ExploreEnv`'s.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Termination: no frontier is left that the robot could get to, after it has looked around once more. The robot is
       stuck if it can stand nowhere on its map, or has not come ten centimetres far for half a minute.
    3. Truncation: `time_limit` seconds have passed; decisions are cut short.

    A decision is due when the robot has arrived, when its frontier is gone (and at least a second has passed), when it
    has not come half a metre far for ten seconds or there is no way any more, or when the drive has taken
    `max_decision_time`. A manoeuvre to get free is finished first, and looking around, where no frontier is left, comes
    on top: `decision_time` counts both. To go on to the same frontier, choose it again: `chosen` marks it.

    ## Information
    What `ExploreEnv` gives, and each step: `action_mask` (int8), `action` (the candidate that was taken; -1 where there
    was none and the robot looked around), `outcome` (`"arrived"`, `"frontier_gone"`, `"failed"`, `"time_up"`,
    `"looked_around"`, `"episode_end"`; `"reset"` after one), `decision_time` [s], `decision_length` [m],
    `decision_steps` (control steps), `area_left` (explorable and unknown) [m2]. `end_reason` may also be
    `"no_reachable_frontier"` or `"stuck"`.

    ## Arguments
    Those of `ExploreEnv`, and

    | argument | default | meaning |
    |---|---|---|
    | `max_candidates` | `24` | frontiers that are offered at most |
    | `max_decision_time` | `4.0` | longest drive, but for manoeuvres to get free and looking around [s] |
    | `control_hz` | `5.0` | control steps per second |

    ## Version History
    * v0: first version
    """

    metadata = ExploreEnv.metadata

    def __init__(
        self,
        *,
        max_candidates: int = 24,
        max_decision_time: float = 4.0,
        control_hz: float = 5.0,
        **arguments: Any,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        self.explore = ExploreEnv(control_hz=control_hz, **arguments)
        """The environment that is driven."""
        self.choice = make_choice(self.explore, max_candidates, max_decision_time)
        """What there is to choose from, and the pilot."""
        self.render_mode = self.explore.render_mode
        self.metadata = self.explore.metadata
        self.action_space = spaces.Discrete(max_candidates)
        self.observation_space: spaces.Space[Any] = candidates_space(max_candidates)
        self._command = np.zeros(2, dtype=np.float32)
        self._ended = [False, False]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the robot into a place it does not know and return the first observation and info."""
        super().reset(seed=seed)
        self._observation, info = self.explore.reset(seed=seed)
        reading = self.explore.reading
        self.choice.reset()
        self.choice.sense(reading.ranges, 0.0, 0.0, reading.bumper)
        self.choice.survey(self)
        self._steps = self._touches = 0
        return self._observe(), self._complete(info, info, -1, RESET)

    def step(self, action: np.int64) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive until the next decision is due.

        Raises:
            ValueError: if the action is not an integer from 0 to `max_candidates` - 1.
        """
        if not self.action_space.contains(action):
            raise ValueError(f"action must be an integer from 0 to {len(self.choice.features) - 1}, got {action!r}")
        choice, explore = self.choice, self.explore
        taken = choice.valid(int(action))
        self._steps = self._touches = 0
        before = self._info
        outcome = choice.decide(taken, self)
        info = self._complete(self._info, before, taken, outcome)
        terminated, truncated = self._ended
        if not (terminated or truncated or len(choice.places)):
            terminated = True
            info["map_iou"] = map_iou(explore.belief.grid, explore.coverage.area, explore.start)
            info["end_reason"] = choice.end_reason
        return self._observe(), sum(info["rewards"].values()), terminated, truncated, info

    def action_masks(self) -> np.ndarray:
        """Return which actions have a candidate, shape (max_candidates,), bool, as sb3-contrib's MaskablePPO asks."""
        return self.choice.mask.astype(np.bool_)

    def render(self) -> np.ndarray | None:
        """Draw this moment; an array (height, width, 3), uint8, for `rgb_array`."""
        return self.explore.render()

    def close(self) -> None:
        """Release the physics engine and the window."""
        self.explore.close()

    @property
    def grid(self) -> OccupancyGrid:
        """The map that the robot believes in."""
        return self.explore.belief.grid

    @property
    def pose(self) -> Pose2D:
        """Where the robot believes to be, map frame."""
        return self.explore.belief.pose

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.explore.reading.time

    def drive(self) -> int:
        """Drive until the pilot has something to say; see `envs.frontier_choice`."""
        choice, explore = self.choice, self.explore
        pilot, robot = choice.pilot[0], explore.robot
        motion = self._observation["motion"]
        while True:
            explore.plan = choice.plan
            v = float(motion[0]) * robot.max_v
            act(pilot, choice.path, choice.obstacles, *self.pose, v, choice.numbers, self._command)
            self._observation, _, *self._ended, self._info = explore.step(self._command)
            self._steps += 1
            motion, reading = self._observation["motion"], explore.reading
            self._touches += reading.bumper
            choice.sense(reading.ranges, float(motion[0]) * robot.max_v, float(motion[1]) * robot.max_w, reading.bumper)
            if any(self._ended):
                return OVER
            grid = self.grid
            map_frame = (grid.data, grid.resolution, *grid.origin, choice.block, choice.given_up)
            code = judge(pilot, choice.obstacles, *self.pose, reading.bumper, *map_frame, choice.numbers)
            if code != DRIVING:
                return code

    def _observe(self) -> dict[str, np.ndarray]:
        return {
            "candidates": self.choice.features.copy(),
            "action_mask": self.choice.mask,
            "map": self._observation["map_far"],
            "motion": self._observation["motion"],
        }

    def _complete(self, info: dict[str, Any], before: dict[str, Any], action: int, outcome: int) -> dict[str, Any]:
        """Return the info of `ExploreEnv` after a decision, with what there is to say of the decision."""
        self._info = info
        gained = info["explored_area"] - before["explored_area"]
        duration = self._steps * self.explore.control_period
        touching, is_covered = self._touches / max(self._steps, 1), outcome != RESET and info["is_success"]
        return info | {
            "rewards": self.explore.weights.terms(gained, touching, is_covered, duration),
            "action_mask": self.choice.mask,
            "action": action,
            "outcome": OUTCOMES[outcome],
            "decision_time": duration,
            "decision_length": info["path_length"] - before["path_length"],
            "decision_steps": self._steps,
            "area_left": self.explore.coverage.area.area - info["explored_area"],
        }
