"""The tracking environment: follow a route by a pose that is fused from map, encoders and compass."""

import math
from collections.abc import Mapping
from typing import Any

from envs.arguments import check_positive
from envs.estimation.motion import make_motion_source
from envs.geometry import Pose2D
from envs.localization import Amcl, AmclParams
from envs.localization.ekf import Estimate
from envs.localization.fusion import FusedPose
from envs.navigate import KnownMapEnv
from envs.observations import Observations
from envs.randomization import Ranges
from envs.rendering.scene import NavigationScene
from envs.robot import Robot
from envs.robots import RobotParams, load_robot
from envs.simulation import make_simulator
from envs.tasks.follow_route import FollowRoute
from envs.tasks.rewards import TrackRewards
from envs.tasks.route import Route
from envs.worlds import World

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
"""A map with cells of 0.02 m and a lidar with smaller errors deserve a sharper sensor model than Nav2's defaults."""
OBSERVATIONS = ("scan", "route", "motion")
"""Parts of an observation by default."""


class TrackEnv(KnownMapEnv):
    """Follow a route with a robot that is localized by a map, its wheels and a compass.

    ## Description
    A differential-drive robot starts at the beginning of a route, with a map that was made beforehand by driving the route
    by hand. Each step drives it for one control period. A localizer (AMCL) then finds it on the map, at a lower rate and
    with latency; encoders measure its speed, a compass its heading; and an extended Kalman filter fuses them into the pose
    in which the robot sees the route. The task is to follow the route to its end. The defaults repeat the experiment of
    Nguyen et al. (2021), see docs/ekf.md: a rectangle of 78 m at 0.8 m/s, with 17 control periods per second.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict` (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `route` | `Box(-1, 1, (10, 2), float32)` | points of the route 0, 0.4, ... 3.6 m ahead, as (forward, left) of the estimated pose, over 5 m |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by the filter over the limits, last action (2), bumper pressed (0 or 1), time since the reset over 600 s (at most 1) |

    ## Rewards
    The sum of the terms in `info["rewards"]`, weighted by `TrackRewards`: `progress` along the route, `deviation` from it,
    `time`, `collision`, `completed`. Progress and deviation are the true ones, not the estimated ones.

    ## Starting State
    The robot is at rest at the beginning of the route, off by a normal draw with the standard deviations
    `start_spread`; the filter assumes that it starts exactly there.

    ## Episode End
    1. Termination: the end of the route is reached.
    2. Termination: the robot is `max_deviation` away from the route.
    3. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `progress` (share of the route driven), `deviation` (to the left of the route [m]), `pose_error` (position
    [m], heading [rad]), `path_length` [m], `collisions` (contacts so far), `is_lost` (whether the localizer says that it
    is), `time` [s], `rewards` (terms), `is_success`; at the end also `end_reason` (`"completed"`, `"strayed"` or
    `"time_limit"`). With `randomize` each step also `randomized`: what the episode has drawn, by name.

    ## Arguments
    | argument | default | meaning |
    |---|---|---|
    | `world` | `"workshop_hall"` | library world, path of a world YAML or of a `map_server` YAML, or a `World` |
    | `robot` | `"mpo_500"` | library robot, path of a robot YAML, or `RobotParams` |
    | `physics` | `"bullet"` | `"bullet"` (PyBullet) or `"kinematic"` |
    | `path` | `None` | points (x, y) in the world frame [m]; `None` is the rectangle of 78 m from the world's first spawn |
    | `fusion` | `"full"` | what is fused into the pose: `"full"` (map, encoders, compass if there is one), `"encoder_compass"`, `"encoder"`, or `"amcl"` (the localizer's own) |
    | `slam` | `"tinyslam"` | which SLAM makes the map |
    | `map_seed` | `0` | seed of the drive that makes the map |
    | `map_resolution` | `0.02` | side of a map cell [m] |
    | `map_latency` | `0.1` | latency of the localizer [s] |
    | `control_hz` | `17.0` | steps per second |
    | `time_limit` | `None` | length of an episode [s]; `None` gives twice the time that the route takes at full speed, and 30 s |
    | `max_deviation` | `2.0` | distance from the route that ends the episode [m] |
    | `start_spread` | `(0.02, 0.02)` | see Starting State [m, rad] |
    | `reward` | `TrackRewards()` | weights, also as a mapping |
    | `observations` | `("scan", "route", "motion")` | parts of the observation, see `envs.observations.make_parts` |
    | `randomize` | `None` | (low, high) by the name of a parameter of the robot, from which each episode draws the true robot's; see docs/training.md |
    | `clip_actions` | `False` | whether actions outside [-1, 1] are clipped |
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
        slam: Any = "tinyslam",
        map_seed: int = 0,
        map_resolution: float = 0.02,
        map_latency: float = 0.1,
        control_hz: float = 17.0,
        time_limit: float | None = None,
        max_deviation: float = 2.0,
        start_spread: tuple[float, float] = (0.02, 0.02),
        reward: TrackRewards | Mapping[str, float] = TrackRewards(),
        observations: Observations = OBSERVATIONS,
        randomize: Ranges | None = None,
        clip_actions: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        check_positive(control_hz=control_hz, map_resolution=map_resolution)
        if not 0 <= map_latency < math.inf:
            raise ValueError(f"map_latency must be finite and not negative, got {map_latency!r}")
        params = load_robot(robot)
        period = 1.0 / control_hz
        self.localizer = Amcl(params.lidar, AMCL_PARAMS)
        self.fused = fused = FusedPose(params, self.localizer, fusion, map_latency)
        task = FollowRoute(
            params,
            fused,
            world=world,
            path=path,
            max_deviation=max_deviation,
            start_spread=start_spread,
            reward=reward,
            physics=physics,
            slam=slam,
            resolution=map_resolution,
            control_period=period,
            seed=map_seed,
        )
        super().__init__(
            task,
            make_simulator(physics, params, period),
            [Robot(params, period, fused, make_motion_source(params, period))],
            observations,
            control_hz=control_hz,
            time_limit=time_limit,
            render_mode=render_mode,
            clip_actions=clip_actions,
            randomize=randomize,
        )
        self.task: FollowRoute = task

    @property
    def estimate(self) -> Estimate:
        """The fused pose and velocity."""
        return self.fused.estimate

    @property
    def start(self) -> Pose2D:
        """World pose of the map frame's origin: the beginning of the route."""
        return self.task.map_pose

    @property
    def route(self) -> Route:
        """The route, map frame."""
        return self.task.route

    @property
    def true_pose(self) -> Pose2D:
        """True pose of the robot in the map frame; for metrics, never for a policy."""
        return self.start.between(self.truths[0].state.pose)

    def scene(self) -> NavigationScene:
        """Return this moment for drawing: the robot on its map, and the route ahead."""
        scene = super().scene()
        scene.plan = self.route.points[self.task.route_progress.index :]
        return scene
