import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from lidarnaut.envs.arguments import is_pose
from lidarnaut.envs.estimation import DeadReckoning, Estimator
from lidarnaut.envs.geometry import ORIGIN, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.localization import Amcl, AmclParams, load_preset
from lidarnaut.envs.observations import Goal, PoseUncertainty
from lidarnaut.envs.robot import Prior, Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import Brief, ObservationPart
from lidarnaut.envs.worlds import World

from .carrot import PlannedCarrot
from .goals import GeodesicDistance, GoalBrief, GoalTask, given_frame, given_map, known_map
from .starts import WorldTask

LOCALIZERS = ("amcl", "odometry", "truth")
"""Names of localizers. "odometry" and "truth" integrate measured or true motion from the true start."""
INITIAL_STD, INITIAL_STD_THETA = 0.1, math.radians(5.0)
"""Standard deviations of the localizer's initial pose: position along an axis [m], heading [rad]."""


@dataclass(kw_only=True, eq=False)
class KnownMapBrief(Brief):
    """Base class of briefs on a known map, with a localizer."""

    localizer: str = "amcl"
    amcl: str | AmclParams = "default"
    initial_pose: Any = "known"
    map: str | Path | OccupancyGrid | None = None

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        self._map, self._covariance = given_map(self.map), cast(np.ndarray | None, None)
        self._read_initial_pose(self.initial_pose, "known", "unknown")
        self.uses_true_motion = self.localizer == "truth"
        super().attach(robot, control_period, physics)

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        return {"pose_uncertainty": PoseUncertainty}

    def make_estimator(self) -> Estimator:
        if self.localizer not in LOCALIZERS:
            raise ValueError(f"unknown localizer {self.localizer!r}; choose one of {', '.join(LOCALIZERS)}")
        return Amcl(self.robot.lidar, load_preset(self.amcl)) if self.localizer == "amcl" else DeadReckoning()

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        pose = self._read_initial_pose(self.initial_pose, "known", "unknown")
        pose = None if pose == "known" else pose  # the start of a real robot is unknown
        return Prior(pose, self._map, self._covariance)

    def _read_initial_pose(self, given: Any, *names: str) -> Any:
        pose: Any = Pose2D(*map(float, given)) if is_pose(given) else given
        if not (isinstance(pose, Pose2D) or (isinstance(pose, str) and pose in names)):
            raise ValueError(f"initial_pose must be {', '.join(map(repr, names))} or (x, y, theta), got {given!r}")
        if pose != "known" and self.localizer != "amcl":
            raise ValueError(f"initial_pose={given!r} needs localizer='amcl', got {self.localizer!r}")
        grid = self._map
        if isinstance(pose, Pose2D) and grid is not None and not grid.contains(grid.cells(np.array(pose[:2]))):
            raise ValueError(f"initial_pose={given!r} lies outside the map, which covers {grid.bounds}")
        return None if pose == "unknown" else pose

    def begin_at(self, pose: Any, covariance: np.ndarray | None = None) -> None:
        """Set the initial pose of the next episode, and its covariance; arguments as for `set_initial_pose`."""
        self.initial_pose, self._covariance = self._read_initial_pose(pose), covariance

    def set_initial_pose(self, pose: Any, covariance: np.ndarray | None = None) -> None:
        """Restart localization; see `LidarEnv.set_initial_pose`.

        `covariance`: that of the pose, shape (3, 3) [m, m, rad]; None for that of `amcl`.
        """
        robot, given = self.robots[0], self._read_initial_pose(pose, "unknown")
        amcl = cast(Amcl, robot.estimator)
        robot.follow(amcl.reset(amcl.rng, given, robot.belief.grid, covariance))


@dataclass(kw_only=True, eq=False)
class KnownMapTask(KnownMapBrief, WorldTask):
    """Base class of tasks on a known map, by default that of a perfect exploration."""

    reset_options: ClassVar[tuple[str, ...]] = ("initial_pose",)

    map_pose: Any = (0.0, 0.0, 0.0)

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        self._frame = self.map_pose
        super().attach(robot, control_period, physics)
        if self._map is None and (self._frame == "spawn" or given_frame(self._frame) != ORIGIN):
            raise ValueError(f"map_pose={self._frame!r} needs a map; the default map is in the world frame")
        self.needs_explorable = self._map is None

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> list[Pose2D]:
        self.map_pose = given_frame(self._frame, world)
        return super().choose_starts(world, start, rng)

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        grid = known_map(self.area) if self._map is None else self._map
        given = self.options.get("initial_pose", self.initial_pose)
        self._given_pose = self._read_initial_pose(given, "known", "unknown")
        if self._given_pose != "known":
            return Prior(self._given_pose, grid)
        pose = self.map_pose.between(self.starts[0])
        std = np.array([INITIAL_STD, INITIAL_STD, INITIAL_STD_THETA])
        prior_pose = Pose2D(*(pose + std * rng.standard_normal(3)))
        cell = grid.cells(np.array(prior_pose[:2]))
        if self.localizer != "amcl" or not grid.contains(cell) or grid.data[tuple(cell)] != 0:
            prior_pose = pose
        return Prior(prior_pose, grid, np.diag(std**2))


@dataclass(kw_only=True, eq=False)
class NavigateBrief(KnownMapBrief, GoalBrief):
    """Brief of `Navigate`."""

    def default_observations(self) -> Sequence[str]:
        return [name for name in super().default_observations() if name != "carrot"]

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        return {"goal": partial(Goal, self), "carrot": partial(PlannedCarrot, self), **super().observation_parts()}


@dataclass(kw_only=True, eq=False)
class Navigate(NavigateBrief, KnownMapTask, GoalTask):
    """Drive to a goal on a known map.

    ## Description
    A differential-drive robot with a 2D lidar drives to a goal on a known map. A localizer updates the pose estimate in
    each step (one control period). Observations contain no ground truth.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, egocentric:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | as in `Explore` |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 8 m x 8 m around the estimated pose, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 32 m x 32 m around the estimated pose, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | as in `Explore` |
    | `goal` | `Box(-1, 1, (5,), float32)` | distance / 32 m (at most 1), cosine and sine of the bearing, cosine and sine of the heading difference |
    | `pose_uncertainty` | `Box(0, 1, (3,), float32)` | standard deviations of position / 1 m and heading / pi (at most 1), 1 if the localizer is lost |

    Map channels as in `Explore`. Optional part: `carrot` (`Box(-1, 1, (3,))`), a point 0.8 m ahead on a planned path, see
    `lidarnaut.envs.tasks.carrot`.

    ## Rewards
    The sum of `info["rewards"]`: `progress` (1 per m of decrease of the true geodesic distance), `time` (-0.02 per s of
    duration), `collision` (-0.5 per s in contact), `reached` (10, once, at the goal). `reward` changes the weights.

    ## Starting State
    The robot is at rest. For `start` see `Explore`. `goal="random"` draws a collision-free goal at least `min_distance`
    away; other goals are (x, y) or (x, y, theta) in the map frame. With `initial_pose="known"` the localizer knows the
    start with standard deviations of 0.1 m and 5 degrees; `"unknown"` means global localization. A pose (x, y, theta),
    map frame, is given to the localizer as in RViz's 2D Pose Estimate, with the standard deviations of `amcl` (0.5 m
    and 15 degrees), and may be wrong.
    `reset(options={"goal": (x, y, theta), "min_distance": ..., "initial_pose": ..., "world": ..., "start": ...})` sets
    one episode, `set_options` all further ones, `set_goal` a new goal and `set_initial_pose` a new pose estimate
    without a reset.

    ## Episode End
    1. Termination: the robot's true pose is within `goal_tolerance` and `heading_tolerance` of the goal.
    2. Truncation: `time_limit` seconds have passed.

    Collisions do not end the episode.

    ## Information
    Each step: `distance_to_goal` (true, straight) [m], `geodesic_distance` (true, around static obstacles) [m],
    `progress` (driven fraction), `pose_error` (position [m], heading [rad]), `is_lost`, `path_length` [m], `collisions`
    (contacts), `time` [s], `rewards`, `is_success`; at the end also `end_reason` (`"reached"` or `"time_limit"`). With
    `randomize` also `randomized` (drawn values by name).

    ## Arguments
    The arguments of `LidarEnv`, `world`, `start`, `split`, `world_size`, `difficulty`, `num_worlds` and `reward` of
    `Explore`, and

    | argument | default | meaning |
    |---|---|---|
    | `localizer` | `"amcl"` | `"amcl"`, `"odometry"` or `"truth"` |
    | `amcl` | `"default"` | preset of AMCL, or `AmclParams` |
    | `initial_pose` | `"known"` | initial pose of the localizer: `"known"`, `"unknown"`, or (x, y, theta), map frame |
    | `map` | `None` | path of a `map_server` YAML or an `OccupancyGrid`; `None` for the map of a perfect exploration |
    | `map_pose` | `(0, 0, 0)` | pose of the frame of `map`, world frame; `"spawn"` for the world's first spawn, where maps of explorations with `start="spawn"` begin |
    | `goal` | `"random"` | see Starting State; `"world"` for the world's goal of the nearest spawn |
    | `min_distance` | `1.0` | minimum distance from the start to a random goal [m] |
    | `goal_tolerance` | `0.3` | distance from the goal that counts as reached [m] |
    | `heading_tolerance` | `None` | heading difference that counts as reached [rad]; `None` for 0.25 if a goal (x, y, theta) is given, otherwise pi: any heading |
    | `map_resolution` | `0.05` | size of a cell of the perfect map [m] |

    ## Version History
    * v0: first version
    """

    reset_options = ("goal", "min_distance", "initial_pose")
    weights = {"progress": 1.0, "time": -0.02, "collision": -0.5, "reached": 10.0}

    def _measure_path(self) -> float:
        self._geodesic = GeodesicDistance(self.area, self._true_goal)
        self._path_left = self._path_length = self._geodesic.length(self._true_pose)
        self.end_reason = None
        return self._path_length

    def _usual_time(self, length: float) -> float:
        return super()._usual_time(length) + 60.0 * (self._given_pose != "known")

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        self._true_pose = simulator.states[0].pose
        before, self._path_left = self._path_left, self._geodesic.length(self._true_pose)
        self.end_reason = "reached" if self._is_at_goal() else None
        self._quantities = {"progress": before - self._path_left, "reached": float(self.end_reason is not None)}

    def metrics(self) -> dict[str, Any]:
        pose, goal = self._true_pose, self._true_goal
        return {
            "distance_to_goal": distance(pose.x - goal.x, pose.y - goal.y),
            "geodesic_distance": self._path_left,
            "progress": 1.0 if self._is_at_goal() else max(0.0, 1.0 - self._path_left / max(self._path_length, 1e-9)),
            "is_lost": self.robots[0].belief.is_lost,
            "is_success": self._is_at_goal(),
        }

    def _is_at_goal(self) -> bool:
        to_goal = self._true_pose.between(self._true_goal)
        near, aligned = self.goal_tolerance, self.heading_tolerance or math.pi
        return distance(to_goal.x, to_goal.y) <= near and abs(to_goal.theta) <= aligned
