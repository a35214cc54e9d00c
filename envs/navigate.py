"""The navigation environment: a known map, a goal, and only lidar and wheels to localize by."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from envs.arguments import check_positive, choose_robot
from envs.core import LidarEnv, make_robots
from envs.geometry import OccupancyGrid, Pose2D
from envs.localization import AmclParams, Localizer, PoseEstimate
from envs.localization.localizer import KnownMapEstimator
from envs.observations import Observations
from envs.randomization import Ranges
from envs.rendering.scene import NavigationScene
from envs.robots import RobotParams
from envs.tasks.goals import make_localizer
from envs.tasks.navigate import Navigate
from envs.tasks.rewards import NavigateRewards
from envs.worlds import ExplorableArea, World, load_map

OBSERVATIONS = ("scan", "map_near", "map_far", "motion", "goal", "doubt")
"""Parts of an observation by default."""


class KnownMapEnv(LidarEnv):
    """What the environments on a known map share: how they are drawn."""

    localizer: Localizer

    def scene(self) -> NavigationScene:
        """Return this moment for drawing: the map with what the robot estimates on it."""
        robot, truth = self.robots[0], self.truths[0]
        return NavigationScene(
            world=self.world,
            robot=self.robot,
            pose=self.map_pose.between(truth.state.pose),
            estimated_pose=robot.belief.pose,
            is_lost=robot.belief.is_lost,
            particles=getattr(self.localizer, "particles", np.empty((0, 3))),
            grid=robot.belief.grid,
            ranges=self.reading.ranges,
            trail=self.map_pose.inverse().transform(truth.trail.positions),
            goal=getattr(self, "goal", None),
            plan=self.plan,
            time=self.time,
            collisions=robot.collisions,
        )

    def _painter(self) -> Callable[[tuple[int, int]], Any]:
        from envs.rendering.navigation import NavigationPicture  # and with it pygame, only when something is drawn

        return NavigationPicture


class NavigateEnv(KnownMapEnv):
    """Drive to a goal on a known map.

    ## Description
    A differential-drive robot with a 2D lidar and wheel encoders has a map of the world. Each step drives it for one
    control period; then a localizer turns the new scan and the motion by odometry into a pose on that map. The policy
    sees what the robot senses and estimates, never ground truth. The task is to get to a goal.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, everything seen from the robot (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 8 m x 8 m around the estimated pose, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 32 m x 32 m around the estimated pose, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by odometry over the limits, last action (2), bumper pressed (0 or 1), time since the reset over 600 s (at most 1) |
    | `goal` | `Box(-1, 1, (5,), float32)` | distance to the goal over 32 m (at most 1), cosine and sine of its bearing, cosine and sine of the turn to its heading |
    | `doubt` | `Box(0, 1, (3,), float32)` | standard deviation of the estimated position over 1 m and of the heading over pi (at most 1), 1 if the localizer says that it is lost |

    Map channels: 0 occupied, 1 free, 2 where the robot has been by its own estimate. Axis 1 points forward, axis 2 to the left.
    Unknown is 0 in channels 0 and 1.

    ## Rewards
    The sum of the terms in `info["rewards"]`, weighted by `NavigateRewards`: `progress` (metres by which the true geodesic
    distance to the goal, around all that does not move, became shorter), `time`, `collision`, `reached`.

    ## Starting State
    The robot is at rest. `start="random"` draws its pose uniformly over where it fits, `start="spawn"` takes the
    world's first spawn pose, a tuple `(x, y, theta)` (world frame) is taken as it is; goals likewise, at least 1 m away,
    in the map's frame if given. With `initial_pose="known"` the localizer is given the start with an error of 0.1 m and 5
    degrees (standard deviations); with `"unknown"` the robot can be anywhere on the map. It looks at scans from the first step on. `reset(options={"goal": (x, y,
    theta), "world": ..., "start": ...})` chooses for one episode, `set_goal` sets a further goal without a reset.

    ## Episode End
    1. Termination: the robot's true base pose is within `goal_tolerance` of the goal, and its heading within
       `heading_tolerance` of the goal's.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `distance_to_goal` (true, straight) [m], `way_to_goal` (true, geodesic) [m], `progress` (share of the way that is done), `pose_error`
    (position [m], heading [rad]), `is_lost`, `path_length` [m], `collisions` (contacts so far), `time` [s], `rewards`
    (terms), `is_success`; at the end also `end_reason` (`"reached"` or `"time_limit"`). With `randomize` each step also
    `randomized`: what the episode has drawn, by name.

    ## Arguments
    | argument | default | meaning |
    |---|---|---|
    | `world` | `"turtlebot3_world"` | library world, procedural family (`rooms`, `maze`, `warehouse`, `caves`, `wings`, `halls`), path of a world YAML or of a `map_server` YAML, or a `World` |
    | `robot` | `None` | library robot, path of a robot YAML, or `RobotParams`; `None` takes the world's usual robot |
    | `physics` | `"bullet"` | `"bullet"` (PyBullet) or `"kinematic"` |
    | `localizer` | `"amcl"` | `"amcl"`, `"odometry"` or `"truth"` |
    | `amcl` | `"default"` | preset of AMCL, or `AmclParams` |
    | `initial_pose` | `"known"` | whether the localizer is given where the robot starts: `"known"` or `"unknown"` |
    | `map` | `None` | path of a `map_server` YAML or an `OccupancyGrid`; `None` takes the map that a perfect exploration would give |
    | `map_pose` | `(0, 0, 0)` | pose of the map's frame in the world |
    | `goal` | `"random"` | see Starting State |
    | `goal_tolerance` | `0.3` | distance from the goal that counts as reached [m] |
    | `heading_tolerance` | `pi` | turn from the goal's heading that counts as reached [rad]; any by default |
    | `control_hz` | `10.0` | steps per second |
    | `time_limit` | `None` | length of an episode [s]; `None` gives a time that grows with the distance to the goal |
    | `start` | `"random"` | see Starting State |
    | `split` | `"train"` | which seeds of a procedural family: `"train"` or `"test"` |
    | `world_size` | `None` | outer size (x, y) of a procedural world [m]; `None` leaves it to the family |
    | `reward` | `NavigateRewards()` | weights, also as a mapping |
    | `map_resolution` | `0.05` | side of a cell of the perfect map [m] |
    | `observations` | `("scan", "map_near", "map_far", "motion", "goal", "doubt")` | parts of the observation, see `envs.observations.make_parts` |
    | `randomize` | `None` | (low, high) by the name of a parameter of the robot, from which each episode draws the true robot's; see docs/training.md |
    | `clip_actions` | `False` | whether actions outside [-1, 1] are clipped |
    | `render_mode` | `None` | `"human"` or `"rgb_array"` |

    ## Version History
    * v0: first version
    """

    def __init__(
        self,
        *,
        world: str | World = "turtlebot3_world",
        robot: str | RobotParams | None = None,
        physics: str = "bullet",
        localizer: str = "amcl",
        amcl: str | AmclParams = "default",
        initial_pose: Literal["known", "unknown"] = "known",
        map: str | Path | OccupancyGrid | None = None,
        map_pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        goal: Literal["random"] | tuple[float, float, float] = "random",
        goal_tolerance: float = 0.3,
        heading_tolerance: float = math.pi,
        control_hz: float = 10.0,
        time_limit: float | None = None,
        start: Literal["random", "spawn"] | tuple[float, float, float] = "random",
        split: Literal["train", "test"] = "train",
        world_size: tuple[float, float] | None = None,
        reward: NavigateRewards | Mapping[str, float] = NavigateRewards(),
        map_resolution: float = 0.05,
        observations: Observations = OBSERVATIONS,
        randomize: Ranges | None = None,
        clip_actions: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        if initial_pose == "unknown" and localizer != "amcl":
            raise ValueError(f"initial_pose='unknown' needs localizer='amcl', got {localizer!r}")
        check_positive(map_resolution=map_resolution)
        params = choose_robot(robot, world)
        task = Navigate(
            params,
            world=world,
            split=split,
            world_size=world_size,
            start=start,
            goal=goal,
            goal_tolerance=goal_tolerance,
            heading_tolerance=heading_tolerance,
            initial_pose=initial_pose,
            is_exact=localizer != "amcl",
            map=load_map(map) if isinstance(map, str | Path) else map,
            map_pose=map_pose,
            reward=reward,
            resolution=map_resolution,
        )
        self.localizer = make_localizer(localizer, params.lidar, amcl)
        simulator, robots = make_robots(
            params,
            physics,
            control_hz,
            lambda: KnownMapEstimator(self.localizer),
            uses_truth=localizer == "truth",
        )
        super().__init__(
            task,
            simulator,
            robots,
            observations,
            control_hz=control_hz,
            time_limit=time_limit,
            render_mode=render_mode,
            clip_actions=clip_actions,
            randomize=randomize,
        )
        self.task: Navigate = task
        self.resolution = map_resolution

    @property
    def goal(self) -> Pose2D:
        """Where to go, map frame."""
        return self.task.goal

    @property
    def area(self) -> ExplorableArea:
        """The true part of the world that can be reached."""
        return self.task.area

    @property
    def estimate(self) -> PoseEstimate:
        """What the localizer says."""
        return self.localizer.estimate

    def set_goal(self, goal: tuple[float, float, float]) -> None:
        """Set a further goal (x, y, theta), map frame, from where the robot is; the next step goes on towards it.

        Raises:
            ValueError: if the goal is not finite, or no pose that the robot can reach.
        """
        self._set_time_limit(self.time + self.task.set_goal(goal))
        self.plan = None
