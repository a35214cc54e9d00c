import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import is_number
from lidarnaut.envs.estimation import NO_UPDATE
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.measures import EXPLORATION, RETURN
from lidarnaut.envs.observations import Home, Peers
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import ObservationPart

from .coverage import Coverage, map_iou
from .starts import UnknownWorldBrief, UnknownWorldTask

HOME_RADIUS = 0.3
"""The robot has returned within this distance of its start [m]."""
MAX_ROBOTS = 4
"""Maximum number of robots in a team."""


@dataclass(kw_only=True, eq=False)
class ExploreBrief(UnknownWorldBrief):
    """Brief of `Explore` and `ExploreTeam`."""

    is_returning = False
    """Whether the robot has to return now."""
    return_home: bool = False

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        parts: dict[str, Callable[..., ObservationPart]] = {}
        if self.return_home:
            parts["home"] = partial(Home, self)
        if self.num_robots > 1:
            parts["teammates"] = partial(Peers, self.num_robots - 1)
        return parts

    def call_back(self) -> None:
        """End exploration, and require the robot to return; ValueError without `return_home=True`."""
        if not self.return_home:
            raise ValueError("call_back needs return_home=True")
        self.is_returning = True


@dataclass(kw_only=True, eq=False)
class Explore(ExploreBrief, UnknownWorldTask):
    """Explore an unknown world with a lidar robot.

    ## Description
    A differential-drive robot with a 2D lidar explores a world without a map. A SLAM updates map and pose estimate in
    each step (one control period). Observations contain no ground truth.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.
    Actions outside raise an error; `clip_actions=True` clips them.

    ## Observation Space
    `Dict`, egocentric; `observations` selects the parts:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range / maximum range; 1 no return; 0 lost beam or obstacle too near |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | map, 8 m x 8 m around the robot, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | map, 32 m x 32 m around the robot, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by odometry / limits, last action (2), bumper contact (0 or 1), time since the reset / 600 s (at most 1) |
    | `plan` (not by default) | `Box(-1, 1, (27,), float32)` | paths to the three best frontiers, see `lidarnaut.envs.observations.Plan` |

    Map channels: 0 occupied, 1 free, 2 visited (estimated). Axis 1 points forward, axis 2 to the left. Unknown is 0 in
    channels 0 and 1.

    ## Rewards
    The sum of `info["rewards"]`: `explored` (1 per m2 of cells newly mapped at their true position and observed by a
    true scan), `time` (-0.02 per s of duration), `collision` (-0.5 per s in contact), `completed` (10, once, at the
    target coverage); also `returned` (10, once, at the start pose, with `return_home=True`). `reward` changes the
    weights.

    ## Starting State
    The robot is at rest with an empty map. `start="random"` draws a collision-free pose uniformly, clear of people on
    fixed routes; `start="spawn"` is the world's first spawn pose; a tuple `(x, y, theta)` is in the world frame.
    Procedural families draw a new world at each reset. `reset(options={"world": ..., "start": ...})` sets one episode.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    Collisions do not end the episode.

    With `return_home=True`, the robot has to return after it reaches the target coverage; the episode terminates when
    its true position is within 0.3 m of the start. The default observation has a part `home`, `Box(-1, 1, (4,),
    float32)`: 1 once the robot has to return, estimated distance / 32 m, cosine and sine of the bearing.

    ## Information
    Each step: `explored_fraction`, `explored_area` [m2], `pose_error` (position [m], heading [rad]), `path_length` [m],
    `collisions` (contacts), `time` [s], `rewards`, `is_success`; at the end also `map_iou`, `area_left` (unexplored)
    [m2] and `end_reason` (`"covered"` or `"time_limit"`). With `return_home=True` also `returned` and `time_home`
    (since the return began) [s]; `end_reason` is `"returned"` instead of `"covered"`, and `is_success` requires both.
    With `randomize` also `randomized` (drawn values by name).

    ## Arguments
    The arguments of `LidarEnv`, and

    | argument | default | meaning |
    |---|---|---|
    | `world` | `"turtlebot3_world"` | library world, procedural family (such as `rooms`), path of a world YAML or of a `map_server` YAML, a `World`, or a list of these to draw from |
    | `slam` | `"hector"` | `"hector"`, `"tinyslam"`, `"graph"` (loop closures), `"gmapping"` (one robot), `"odometry"` or `"truth"` (mapping at odometry or true poses), also with parameters (`"hector?preset=faithful"`), or your own, see `lidarnaut.envs.slam.make_slam` |
    | `target_coverage` | `0.99` | explored fraction that ends the episode |
    | `start` | `"random"` | see Starting State |
    | `split` | `"train"` | seeds of a procedural family: `"train"`, `"validation"` or `"test"` |
    | `world_size` | `None` | outer size (x, y) of a procedural world [m]; `None` for the family's default |
    | `difficulty` | `None` | difficulty of `clutter` worlds, from 0 to 1; `None` draws it |
    | `num_worlds` | `None` | number of worlds of a procedural family, for faster resets; `None` for no limit |
    | `reward` | `None` | changed weights by name, or a subclass of `lidarnaut.envs.task.Rewards` |
    | `map_resolution` | `0.05` | size of a map cell [m] |
    | `return_home` | `False` | whether the robot has to return, see Episode End; one robot |

    ## Version History
    * v0: first version
    """

    measures = EXPLORATION
    progress = "explored_fraction"
    weights = {"explored": 1.0, "time": -0.02, "collision": -0.5, "completed": 10.0}

    target_coverage: float = 0.99

    @property
    def rests_between_scans(self) -> bool:  # type: ignore[override]
        """True if `update` may be skipped in control periods without a new scan."""
        return type(self) in (Explore, ExploreTeam) and not self.return_home

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if not (is_number(self.target_coverage) and 0 < self.target_coverage <= 1):
            raise ValueError(f"target_coverage must lie in (0, 1], got {self.target_coverage!r}")
        if self.return_home and self.num_robots > 1:
            raise ValueError("return_home is for one robot, not for a team")
        if self.return_home:
            self.measures = (*EXPLORATION, *RETURN)  # type: ignore[assignment,misc]
            self.weights = {**self.weights, "returned": 10.0}
        back = " and the robot is back at its start" if self.return_home else ""
        self.success_condition = f"{100.0 * self.target_coverage:g} % is explored{back}"
        super().attach(robot, control_period, physics)

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        self.coverage = Coverage(self.area, self.map_pose, simulator.robot.lidar)
        for robot, pose in zip(robots, self.starts, strict=True):
            self._cover(robot, pose)
        self.is_returning = self._is_covered = False
        self._time_home = 0.0
        return self.area.usual_time_limit(self.robot.max_v)

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        self._time_home += period * self.is_returning
        gained = 0.0
        for k, robot in enumerate(robots):
            if robot.belief.update is not NO_UPDATE:
                gained += self._cover(robot, simulator.states[k].pose)
        is_covered = self.coverage.explored_fraction >= self.target_coverage
        self._quantities = {"explored": gained, "completed": float(is_covered and not self._is_covered)}
        self._is_covered |= is_covered
        if not self.return_home:
            self.end_reason = "covered" if is_covered else None
            return
        self.is_returning |= is_covered
        (x, y, _), (home_x, home_y, _) = simulator.states[0].pose, self.map_pose
        if self.is_returning and math.hypot(x - home_x, y - home_y) <= HOME_RADIUS:
            self.end_reason = "returned"
        self._quantities["returned"] = float(self.end_reason == "returned")

    def metrics(self) -> dict[str, Any]:
        fraction = self.coverage.explored_fraction
        metrics = {"explored_fraction": fraction, "explored_area": self.coverage.explored_area}
        if not self.return_home:
            return metrics | {"is_success": fraction >= self.target_coverage}
        returned = self.end_reason == "returned"
        metrics |= {"is_success": self._is_covered and returned, "returned": returned}
        return metrics | {"time_home": self._time_home}

    def final_metrics(self) -> dict[str, Any]:
        area = self.coverage.area
        left = area.area - self.coverage.explored_area
        return {"map_iou": map_iou(self.robots[0].belief.grid, area, self.map_pose), "area_left": left}

    def _cover(self, robot: Robot, true_pose: Pose2D) -> float:
        belief = robot.belief
        return self.coverage.update(belief.update, belief.grid.resolution, robot.ranges, true_pose)


@dataclass(kw_only=True, eq=False)
class ExploreTeam(Explore):
    """Explore an unknown world with a team of lidar robots that share one map.

    ## Description
    The task `Explore` with one to four identical robots that start near each other with known relative poses (Umari and
    Mukhopadhyay, 2017). Each robot matches its scans to the shared map. Beams that end at a teammate's estimated pose
    are not mapped.

    ## Action Space
    `Box(-1, 1, (num_robots, 2), float32)`, one action of `Explore` per robot.

    ## Observation Space
    `Dict`, egocentric, one row per robot:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_robots, num_beams), float32)` | ranges, including returns from teammates |
    | `map_near` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 8 m x 8 m around each robot |
    | `map_far` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 32 m x 32 m around each robot |
    | `motion` | `Box(-1, 1, (num_robots, 6), float32)` | as in `Explore` |
    | `teammates` | `Box(-1, 1, (num_robots, 4 * (num_robots - 1)), float32)` | per teammate, by index: estimated position forward and left / 16 m, cosine and sine of the heading |

    Channel 2 of the maps is visited by any robot.

    ## Rewards
    The sum of `info["rewards"]`, as in `Explore`: `explored` (each cell once per team), `time`, `collision` (per robot
    in contact, also with robots), `completed`.

    ## Starting State
    The robots are at rest with an empty map, whose frame begins at robot 0. `start` sets the pose of robot 0 as in
    `Explore`; the others start within 2 m, in its line of sight and 0.5 m apart, with random headings; in narrow spaces
    farther away, closer together, or out of sight. One pose per robot, `((x, y, theta), ...)`, is used as given.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    ## Information
    As in `Explore`; `pose_error`, shape (num_robots, 2), `path_length` and `collisions` per robot.

    ## Arguments
    The arguments of `Explore` except `return_home`, and

    | argument | default | meaning |
    |---|---|---|
    | `num_robots` | `2` | number of robots, 1 to 4 |
    | `start` | `"random"` | also one pose per robot |

    ## Version History
    * v0: first version
    """

    is_team = True

    num_robots: int = 2

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if self.num_robots not in range(1, MAX_ROBOTS + 1):
            raise ValueError(f"num_robots must be a whole number from 1 to {MAX_ROBOTS}, got {self.num_robots!r}")
        super().attach(robot, control_period, physics)
