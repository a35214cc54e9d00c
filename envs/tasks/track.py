import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import check_positive
from lidarnaut.envs.geometry import ORIGIN, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.localization import Amcl, AmclParams
from lidarnaut.envs.localization.fusion import FusedPose, start_covariance
from lidarnaut.envs.measures import ROUTE
from lidarnaut.envs.observations import RouteAhead
from lidarnaut.envs.robot import Prior, Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import ObservationPart, Task
from lidarnaut.envs.worlds import World, load_world

from .goals import given_frame, given_map
from .route import END, Progress, Route, rectangle
from .route_map import make_route_map

AMCL_PARAMS = AmclParams(
    sensor="likelihood_field_prob",
    max_beams=540,
    sigma_hit=0.05,
    squash=4.0,
    alpha1=0.05,
    alpha2=0.01,
    alpha3=0.02,
    alpha4=0.01,
    update_min_d=0.1,
    update_min_a=0.1,
)
"""Parameters of AMCL with a sharper sensor model than Nav2's defaults, for map cells of 0.01 m."""


@dataclass(kw_only=True, eq=False)
class Track(Task):
    """Follow a route with localization by map, wheel encoders and compass.

    ## Description
    A differential-drive robot follows a route on a map from an earlier manual drive. An extended Kalman filter fuses
    wheel encoders, a compass, and delayed AMCL poses at a lower rate. The defaults repeat the experiment of Nguyen et
    al. (2021), see docs/concepts/ekf.md: a rectangle of 78 m at 0.8 m/s.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, egocentric:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | as in `Explore` |
    | `route` | `Box(-1, 1, (10, 2), float32)` | route points 0, 0.4, ... 3.6 m ahead, (forward, left) / 5 m from the estimated pose |
    | `motion` | `Box(-1, 1, (6,), float32)` | as in `Explore`, speeds by the filter |

    ## Rewards
    The sum of `info["rewards"]`: `progress` (1 per m along the route), `deviation` (-2 per m and s away from the
    route), `time` (-0.02 per s of duration), `collision` (-0.5 per s in contact), `completed` (10, once, at the end),
    by the true pose. `reward` changes the weights.

    ## Starting State
    The robot is at rest at the beginning of the route, with normally distributed errors of standard deviations
    `start_spread`, unknown to the filter.

    ## Episode End
    1. Termination: the robot reaches the end of the route.
    2. Termination: the robot is `max_deviation` away from the route.
    3. Truncation: `time_limit` seconds have passed.

    Collisions do not end the episode.

    ## Information
    Each step: `progress` (fraction of the route), `deviation` (to the left [m]), `pose_error` (position [m], heading
    [rad]), `path_length` [m], `collisions` (contacts), `is_lost` (reported by AMCL), `time` [s], `rewards`,
    `is_success`; at the end also `end_reason` (`"completed"`, `"strayed"` or `"time_limit"`). With `randomize` also
    `randomized` (drawn values by name).

    ## Arguments
    The arguments of `LidarEnv` (`robot` is `"mpo_500"` and `control_hz` 17 by default), and

    | argument | default | meaning |
    |---|---|---|
    | `world` | `"workshop_hall"` | library world, path of a world YAML or of a `map_server` YAML, or a `World` |
    | `path` | `None` | points (x, y), world frame [m]; `None` for the rectangle from the world's first spawn |
    | `fusion` | `"full"` | inputs of the pose estimate: `"full"` (map, encoders, compass if available), `"encoder_compass"`, `"encoder"`, or `"amcl"` |
    | `map` | `None` | path of a `map_server` YAML or an `OccupancyGrid`; `None` for the map of a mapping drive |
    | `map_pose` | `(0, 0, 0)` | pose of the frame of `map`, world frame; `"spawn"` for the world's first spawn |
    | `slam` | `"hector"` | SLAM of the mapping drive, also with parameters (`tinyslam?sigma_xy=0.02`) |
    | `map_seed` | `0` | seed of the mapping drive |
    | `map_resolution` | `0.01` | size of a map cell [m] |
    | `map_latency` | `0.1` | latency of AMCL [s] |
    | `max_deviation` | `2.0` | distance from the route that ends the episode [m] |
    | `start_spread` | `(0.02, 0.02)` | see Starting State [m, rad] |
    | `reward` | `None` | changed weights by name, or a subclass of `lidarnaut.envs.task.Rewards` |

    ## Version History
    * v0: first version
    """

    measures = ROUTE
    progress = "progress"
    success_condition = "the robot reaches the end of its route"
    weights = {"progress": 1.0, "deviation": -2.0, "time": -0.02, "collision": -0.5, "completed": 10.0}

    world: str | World = "workshop_hall"
    path: Any = None
    fusion: str = "full"
    map: str | Path | OccupancyGrid | None = None
    map_pose: Any = (0.0, 0.0, 0.0)
    slam: Any = "hector"
    map_seed: int = 0
    map_resolution: float = 0.01
    map_latency: float = 0.1
    max_deviation: float = 2.0
    start_spread: tuple[float, float] = (0.02, 0.02)
    reward: Any = None

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        check_positive(max_deviation=self.max_deviation, map_resolution=self.map_resolution)
        if not 0 <= self.map_latency < math.inf:
            raise ValueError(f"map_latency must be finite and not negative, got {self.map_latency!r}")
        spread = self.start_spread
        if len(spread) != 2 or not all(0 <= std < math.inf for std in spread):
            raise ValueError(f"start_spread must be two non-negative numbers, got {spread!r}")
        super().attach(robot, control_period, physics)
        self._world = self.world if isinstance(self.world, World) else load_world(self.world)
        self.route_world = Route.of(rectangle(self._world.spawns[0]) if self.path is None else self.path)
        self._map, frame = given_map(self.map), given_frame(self.map_pose, self._world)
        if self._map is None and frame != ORIGIN:
            raise ValueError(f"map_pose={self.map_pose!r} needs a map; the frame of a mapping drive is its start")
        self.map_pose = self.route_world.start if self._map is None else frame
        self.route = self.route_world.seen_from(self.map_pose)

    def default_observations(self) -> Sequence[str]:
        return ("scan", "route", "motion")

    def make_estimator(self) -> FusedPose:
        amcl = Amcl(self.robot.lidar, AMCL_PARAMS)
        self._fused = FusedPose(self.robot, self.control_period, amcl, self.fusion, self.map_latency)
        return self._fused

    @property
    def route_ahead(self) -> np.ndarray:
        """Remaining route points, shape (n, 2), float64, map frame [m]."""
        return self.route.points[self.route_progress.index :]

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        return {"route": partial(RouteAhead, self)}

    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        """Return the world of the route; ValueError if `world` is not None, as the world cannot change."""
        if world is not None:
            raise ValueError("the world of a route cannot change at a reset; make another environment")
        return self._world

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> list[Pose2D]:
        """Return the start pose near the beginning of the route, world frame; ValueError if `start` is given."""
        if start is not None:
            raise ValueError("the start of a route cannot change at a reset; make another environment")
        spread, turn = self.start_spread
        offset = Pose2D(*(rng.standard_normal(3) * (spread, spread, turn)).tolist())
        self.starts = [self.route_world.start.compose(offset)]
        return self.starts

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        """Return the known map and the robot's initial pose for the localizer.

        Without `map`, the map comes from a simulated mapping drive at the first call.
        """
        covariance = start_covariance(*self.start_spread)[:3, :3]
        if self._map is not None:
            self._fused.north = self.map_pose.theta
            return Prior(self.map_pose.between(self.route_world.start), self._map, covariance)
        drive = self.physics, self.slam, self.route_world.points.tobytes()
        made_with = self.map_resolution, self.control_period, self.map_seed
        route_map = make_route_map(self._world, self.robot, *drive, *made_with)
        self._fused.north, self._fused.pivot = route_map.north, Pose2D(route_map.pivot, 0.0, 0.0)
        return Prior(ORIGIN, route_map.grid, covariance)

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        self.route_progress, self._true_progress = Progress(self.route), Progress(self.route_world)
        self._follow(self.starts[0])
        # twice the time at maximum speed, plus 30 s
        return 30.0 + 2.0 * self.route.length / self.robot.max_v

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        pose, before = simulator.states[0].pose, self._driven
        self._follow(pose)
        away = distance(*(self._true_progress.route.points[self._true_progress.index] - pose[:2]))
        if self._driven >= self.route.length - END:
            self.end_reason = "completed"
        elif away > self.max_deviation:
            self.end_reason = "strayed"
        self._quantities = {"progress": self._driven - before, "deviation": period * abs(self._deviation)}
        self._quantities["completed"] = float(self.end_reason == "completed")

    def quantities(self) -> dict[str, float]:
        return self._quantities

    def metrics(self) -> dict[str, Any]:
        return {
            "progress": self._driven / self.route.length,
            "deviation": self._deviation,
            "is_lost": self.robots[0].belief.is_lost,
            "is_success": self._driven >= self.route.length - END,
        }

    def _follow(self, true_pose: Pose2D) -> None:
        self._driven, self._deviation = self._true_progress.update(true_pose)
        self.route_progress.update(self.robots[0].belief.pose)
