"""The tracking environment: follow a route by a pose that is fused from map, encoders and compass."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.localization import Amcl, AmclParams
from envs.localization.fusion import FusedPose, start_covariance
from envs.observation import fill_motion, scale_scan
from envs.rendering.scene import NavigationScene
from envs.rewards import TrackRewards
from envs.robot_env import RobotEnv, check_positive
from envs.robots import RobotParams, load_robot
from envs.route import Progress, Route, rectangle
from envs.route_map import make_route_map
from envs.worlds import World, load_world

NUM_AHEAD = 10
"""Points of the route that an observation shows."""
AHEAD_SPACING = 0.4
"""Distance between them [m]."""
AHEAD_SCALE = 5.0
"""What 1 stands for in their coordinates [m]."""
END = 0.1
"""Distance from the end of the route at which it counts as reached [m]."""
AMCL_PARAMS = AmclParams(
    sensor="likelihood_field_prob",
    max_beams=180,
    sigma_hit=0.1,
    squash=4.0,
    alpha1=0.05,
    alpha2=0.01,
    alpha3=0.02,
    alpha4=0.01,
    update_min_d=0.2,
    update_min_a=0.1,
)
"""A map with cells of 0.02 m and a lidar that errs by less deserve a sharper look than Nav2's defaults take."""


class TrackEnv(RobotEnv):
    """Follow a route with a robot that knows its place by a map, its wheels and a compass.

    ## Description
    A differential-drive robot stands at the beginning of a route, with a map that was made beforehand by driving the route
    by hand. Each step drives it for one control period. A localiser (AMCL) then finds it on the map, now and then and a
    little late; encoders tell its speed, a compass its heading; and a Kalman filter fuses them into the pose by which
    the robot sees the route. The task is to follow the route to its end. The defaults are the experiment of seed 4: a
    rectangle of 78 m at 0.8 m/s, with 17 control periods per second.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict` (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `route` | `Box(-1, 1, (10, 2), float32)` | points of the route 0, 0.4, ... 3.6 m ahead, as (forward, left) of where the robot believes to be, over 5 m |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by the filter over the limits, last action (2), bumper pressed (0 or 1), share of the time limit passed |

    ## Rewards
    The sum of the terms in `info["rewards"]`, weighted by `TrackRewards`: `progress` along the route, `deviation` from it,
    `time`, `collision`, `completed`. Progress and deviation are the robot's, not those that it believes in.

    ## Starting State
    The robot stands still at the beginning of the route, off by a normal draw with the standard deviations
    `start_spread`; it believes to stand right there.

    ## Episode End
    1. Termination: the end of the route is reached.
    2. Termination: the robot is `max_deviation` away from the route.
    3. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `progress` (share of the route driven), `deviation` (to the left of the route [m]), `pose_error` (position
    [m], heading [rad]), `path_length` [m], `collisions` (contacts so far), `is_lost` (whether the localiser says that it
    is), `time` [s], `rewards` (terms), `is_success`; at the end also `end_reason` (`"completed"`, `"strayed"` or
    `"time_limit"`).

    ## Arguments
    | argument | default | meaning |
    |---|---|---|
    | `world` | `"workshop_hall"` | library world, path of a world YAML or of a `map_server` YAML, or a `World` |
    | `robot` | `"mpo_500"` | library robot, path of a robot YAML, or `RobotParams` |
    | `physics` | `"bullet"` | `"bullet"` (PyBullet) or `"kinematic"` |
    | `path` | `None` | points (x, y) in the world frame [m]; `None` is the rectangle of 78 m from the world's first spawn |
    | `fusion` | `"full"` | what the pose rests on: `"full"` (map, encoders, compass if there is one), `"encoder_compass"`, `"encoder"`, or `"amcl"` (the localiser's own) |
    | `slam` | `"tinyslam"` | which SLAM makes the map |
    | `map_seed` | `0` | seed of the drive that makes the map |
    | `map_resolution` | `0.02` | side of a map cell [m] |
    | `map_latency` | `0.1` | how late the localiser answers [s] |
    | `control_hz` | `17.0` | steps per second |
    | `time_limit` | `None` | length of an episode [s]; `None` gives twice the time that the route takes at full speed, and 30 s |
    | `max_deviation` | `2.0` | distance from the route that ends the episode [m] |
    | `start_spread` | `(0.02, 0.02)` | see Starting State [m, rad] |
    | `reward` | `TrackRewards()` | weights, also as a mapping |
    | `render_mode` | `None` | `"human"` or `"rgb_array"` |

    ## Version History
    * v0: first version
    """

    def __init__(
        self,
        *,
        world: str | World = "workshop_hall",
        robot: str | RobotParams = "mpo_500",
        physics: str = "bullet",
        path: Any = None,
        fusion: str = "full",
        slam: str = "tinyslam",
        map_seed: int = 0,
        map_resolution: float = 0.02,
        map_latency: float = 0.1,
        control_hz: float = 17.0,
        time_limit: float | None = None,
        max_deviation: float = 2.0,
        start_spread: tuple[float, float] = (0.02, 0.02),
        reward: TrackRewards | Mapping[str, float] = TrackRewards(),
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        check_positive(max_deviation=max_deviation)
        if not 0 <= map_latency < math.inf:
            raise ValueError(f"map_latency must be finite and not negative, got {map_latency!r}")
        if len(start_spread) != 2 or not all(0 <= spread < math.inf for spread in start_spread):
            raise ValueError(f"start_spread must be two numbers that are not negative, got {start_spread!r}")
        self.weights = TrackRewards.of(reward)
        super().__init__(
            robot=load_robot(robot),
            physics=physics,
            control_hz=control_hz,
            time_limit=time_limit,
            render_mode=render_mode,
        )
        self.world = world if isinstance(world, World) else load_world(world)
        self.route_world = Route.of(rectangle(self.world.spawns[0]) if path is None else path)
        self.start = self.route_world.start
        """World pose of the map frame's origin."""
        self.route = self.route_world.seen_from(self.start)
        """The route in the map frame."""
        self.time_limit = time_limit or 30.0 + 2.0 * self.route.length / self.robot.max_v
        self.max_deviation = max_deviation
        self._physics, self._slam, self._map_seed, self._resolution = physics, slam, map_seed, map_resolution
        self._start_spread = start_spread
        self.localizer = Amcl(self.robot.lidar, AMCL_PARAMS)
        self.fused = FusedPose(self.robot, self.localizer, fusion, map_latency)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                "scan": spaces.Box(0.0, 1.0, (self.robot.lidar.num_beams,), np.float32),
                "route": spaces.Box(-1.0, 1.0, (NUM_AHEAD, 2), np.float32),
                "motion": spaces.Box(-1.0, 1.0, (6,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the robot at the beginning of the route; the first reset makes the map."""
        super().reset(seed=seed)
        simulator_rng, localizer_rng = self.np_random.spawn(2)
        self.map = make_route_map(
            self.world,
            self.robot,
            self._physics,
            self._slam,
            self.route_world.points.tobytes(),
            self._resolution,
            self.control_period,
            self._map_seed,
        )
        spread, turn = self._start_spread
        off = Pose2D(*(self.np_random.standard_normal(3) * (spread, spread, turn)).tolist())
        self._stand(self.world, self.start.compose(off), simulator_rng)
        origin = Pose2D(0.0, 0.0, 0.0)
        self.estimate = self.fused.reset(
            self.map.grid, self.map.north, origin, self.reading, localizer_rng, start_covariance(spread, turn)
        )
        self.progress, self._true_progress = Progress(self.route), Progress(self.route_world)
        self._driven, self._deviation = self._true_progress.update(self._state.pose)
        self.progress.update(origin)
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(dict.fromkeys(TrackRewards.names(), 0.0))

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1].
        """
        self._drive(action)
        self.estimate = self.fused.update(self.reading)
        self.progress.update(self.estimate.pose)

        driven_before = self._driven
        self._driven, self._deviation = self._true_progress.update(self._state.pose)
        away = distance(*(self._true_progress.route.points[self._true_progress.index] - self._state.pose[:2]))
        completed = self._driven >= self.route.length - END
        strayed = not completed and away > self.max_deviation
        truncated = not (completed or strayed) and self._is_late
        rewards = self.weights.terms(
            self._driven - driven_before, abs(self._deviation), self.reading.bumper, completed, self.control_period
        )
        info = self._info(rewards)
        if completed or strayed or truncated:
            info["end_reason"] = "completed" if completed else "strayed" if strayed else "time_limit"
        if self.render_mode == "human":
            self.render()
        return self._observe(), sum(rewards.values()), completed or strayed, truncated, info

    @property
    def true_pose(self) -> Pose2D:
        """Where the robot truly is, in the map frame; for metrics, never for a policy."""
        return self.start.between(self._state.pose)

    def scene(self) -> NavigationScene:
        """Return this moment for drawing: the robot on its map."""
        return NavigationScene(
            world=self.world,
            robot=self.robot,
            pose=self.true_pose,
            estimated_pose=self.estimate.pose,
            is_lost=self.localizer.estimate.is_lost,
            particles=self.localizer.particles,
            grid=self.map.grid,
            ranges=self.reading.ranges,
            trail=self.start.inverse().transform(self._true_trail.positions),
            goal=None,
            plan=self.route.points[self.progress.index :],
            time=self.reading.time,
            collisions=self._collisions,
        )

    def _painter(self) -> Callable[[tuple[int, int]], Any]:
        from envs.rendering.navigation import NavigationPicture  # and with it pygame, only when something is drawn

        return NavigationPicture

    def _observe(self) -> dict[str, np.ndarray]:
        robot, estimate, scan = self.robot, self.estimate, np.empty_like(self.reading.ranges)
        scale_scan(self.reading.ranges, robot.lidar.range_max, scan)
        ahead = estimate.pose.inverse().transform(self.progress.ahead(AHEAD_SPACING * np.arange(NUM_AHEAD)))
        motion = np.empty(6, dtype=np.float32)
        elapsed = self.reading.time / self.time_limit
        limits, action = (robot.max_v, robot.max_w), (self._action[0], self._action[1])
        fill_motion(estimate.v, estimate.w, *limits, *action, self.reading.bumper, elapsed, motion)
        return {"scan": scan, "route": np.clip(ahead / AHEAD_SCALE, -1.0, 1.0).astype(np.float32), "motion": motion}

    def _info(self, rewards: dict[str, float]) -> dict[str, Any]:
        error = self.estimate.pose.between(self.true_pose)
        return {
            "progress": self._driven / self.route.length,
            "deviation": self._deviation,
            "pose_error": np.array([distance(error.x, error.y), abs(error.theta)]),
            "path_length": self._path_length,
            "collisions": self._collisions,
            "is_lost": self.localizer.estimate.is_lost,
            "time": self.reading.time,
            "rewards": rewards,
            "is_success": self._driven >= self.route.length - END,
        }
