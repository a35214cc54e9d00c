"""The navigation environment: a known map, a goal, and only the lidar and the wheels to tell where the robot is."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from envs.coverage import explorable_area
from envs.estimation.motion import make_motion_source
from envs.geometry import OccupancyGrid, Pose2D
from envs.geometry.pose import distance
from envs.localization import AmclParams
from envs.map_pyramid import MapPyramid
from envs.navigate_setup import DeadReckoning, TrueWay, draw_goal, known_map, make_localizer, read_map
from envs.observation import Trail, observation_space, observe
from envs.rendering.scene import NavigationScene
from envs.rewards import NavigateRewards
from envs.robot_env import RobotEnv, check_positive, choose_robot, choose_start, is_pose, read_start
from envs.robots import RobotParams
from envs.simulation import Twist
from envs.slam import Belief
from envs.worlds import World, world_sampler

GOAL_RANGE = 32.0
"""Distance to the goal that observations show as 1 [m]."""
INITIAL_STD, INITIAL_STD_THETA = 0.1, math.radians(5.0)
"""Error of the pose that a localiser is told at the start, per axis [m] and in heading [rad]."""
NO_CELLS = np.empty((0, 2), dtype=np.int32)


class NavigateEnv(RobotEnv):
    """Drive to a goal on a known map.

    ## Description
    A differential-drive robot with a 2D lidar and wheel encoders has a map of the place. Each step drives it for one
    control period; then a localiser turns the new scan and the encoders' motion into a pose on that map. The policy
    sees what the robot senses and believes, never the truth. The task is to get to a goal.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, everything seen from the robot (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 8 m x 8 m around where the robot believes to be, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 32 m x 32 m around where it believes to be, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by odometry over the limits, last action (2), bumper pressed (0 or 1), share of the time limit passed |
    | `goal` | `Box(-1, 1, (5,), float32)` | distance to the goal over 32 m (at most 1), cosine and sine of its bearing, cosine and sine of the turn to its heading |
    | `doubt` | `Box(0, 1, (3,), float32)` | standard deviation of the believed position over 1 m and of the heading over pi (at most 1), 1 if the localiser says that it is lost |

    Map channels: 0 occupied, 1 free, 2 where the robot believes to have been. Axis 1 points forward, axis 2 to the left.
    Unknown is 0 in channels 0 and 1.

    ## Rewards
    The sum of the terms in `info["rewards"]`, weighted by `NavigateRewards`: `progress` (metres by which the true way to
    the goal, around all that stands still, became shorter), `time`, `collision`, `reached`.

    ## Starting State
    The robot stands still. `start="random"` draws its pose uniformly over where it can stand, `start="spawn"` takes the
    world's first spawn pose, a tuple `(x, y, theta)` (world frame) is taken as it is; goals likewise, at least 1 m away,
    in the map's frame if given. With `initial_pose="known"` the localiser is told the start with an error of 0.1 m and 5
    degrees (standard deviations); with `"unknown"` the robot can be anywhere on the map. It looks at scans from the first step on. `reset(options={"goal": (x, y,
    theta)})` sets the goal of one episode, `set_goal` a further one without a reset.

    ## Episode End
    1. Termination: the robot's base is truly within `goal_tolerance` of the goal, and its heading within
       `heading_tolerance` of the goal's.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `distance_to_goal` (true, as the crow flies) [m], `way_to_goal` (true, around obstacles) [m], `pose_error`
    (position [m], heading [rad]), `is_lost`, `path_length` [m], `collisions` (contacts so far), `time` [s], `rewards`
    (terms), `is_success`; at the end also `end_reason` (`"reached"` or `"time_limit"`).

    ## Arguments
    | argument | default | meaning |
    |---|---|---|
    | `world` | `"turtlebot3_world"` | library world, procedural family (`rooms`, `maze`, `warehouse`, `caves`), path of a world YAML or of a `map_server` YAML, or a `World` |
    | `robot` | `None` | library robot, path of a robot YAML, or `RobotParams`; `None` takes the world's usual robot |
    | `physics` | `"bullet"` | `"bullet"` (PyBullet) or `"kinematic"` |
    | `localizer` | `"amcl"` | `"amcl"`, `"odometry"` (the encoders' pose) or `"truth"` |
    | `amcl` | `"default"` | preset of AMCL, or `AmclParams` |
    | `initial_pose` | `"known"` | whether the localiser is told where the robot starts: `"known"` or `"unknown"` |
    | `map` | `None` | path of a `map_server` YAML or an `OccupancyGrid`; `None` takes the map that a perfect exploration would leave |
    | `map_pose` | `(0, 0, 0)` | pose of the map's frame in the world |
    | `goal` | `"random"` | see Starting State |
    | `goal_tolerance` | `0.3` | distance from the goal that counts as reached [m] |
    | `heading_tolerance` | `pi` | turn from the goal's heading that counts as reached [rad]; any by default |
    | `control_hz` | `10.0` | steps per second |
    | `time_limit` | `None` | length of an episode [s]; `None` gives a time that grows with the way to the goal |
    | `start` | `"random"` | see Starting State |
    | `split` | `"train"` | which seeds of a procedural family: `"train"` or `"test"` |
    | `world_size` | `None` | outer size (x, y) of a procedural world [m]; `None` leaves it to the family |
    | `reward` | `NavigateRewards()` | weights, also as a mapping |
    | `map_resolution` | `0.05` | side of a cell of the perfect map [m] |
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
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        if initial_pose not in ("known", "unknown"):
            raise ValueError(f"initial_pose must be 'known' or 'unknown', got {initial_pose!r}")
        if initial_pose == "unknown" and localizer != "amcl":
            raise ValueError(f"initial_pose='unknown' needs localizer='amcl', got {localizer!r}")
        check_positive(goal_tolerance=goal_tolerance)
        if not 0 < heading_tolerance <= math.pi:
            raise ValueError(f"heading_tolerance must lie in (0, pi], got {heading_tolerance!r}")
        if not (is_pose(goal) or (isinstance(goal, str) and goal == "random")):
            raise ValueError(f"goal must be 'random' or (x, y, theta), got {goal!r}")
        if not is_pose(map_pose):
            raise ValueError(f"map_pose must be (x, y, theta), got {map_pose!r}")
        self._start = read_start(start)
        self.weights = NavigateRewards.of(reward)
        self._sample_world = world_sampler(world, split=split, size=world_size)
        super().__init__(
            robot=choose_robot(robot, world),
            physics=physics,
            control_hz=control_hz,
            time_limit=time_limit,
            render_mode=render_mode,
        )
        self.plan: np.ndarray | None = None
        """Planned path for drawing, shape (n, 2), map frame [m]; set it from outside, `reset` clears it."""
        self.map_pose = Pose2D(*(float(k) for k in map_pose))
        """Pose of the map's frame in the world."""
        self._map = read_map(map)
        self._goal = goal if isinstance(goal, str) else Pose2D(*(float(k) for k in goal))
        self._tolerances = goal_tolerance, heading_tolerance
        self._initial_pose = initial_pose
        self.resolution = map_resolution
        self.localizer = make_localizer(localizer, self.robot.lidar, amcl)
        self.localizer_is_told_the_truth = localizer == "truth"
        self.odometry = make_motion_source(self.robot, self.control_period)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                **observation_space(self.robot).spaces,
                "goal": spaces.Box(-1.0, 1.0, (5,), np.float32),
                "doubt": spaces.Box(0.0, 1.0, (3,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the robot and the goal into the place and return the first observation and info.

        Args:
            seed: of everything random.
            options: `{"goal": (x, y, theta)}` (map frame) for this episode alone.

        Raises:
            ValueError: if the robot cannot stand at the start or at the goal.
        """
        super().reset(seed=seed)
        self.world = self._sample_world(self.np_random)
        self.area = explorable_area(self.world, self.robot, self.resolution)
        start = choose_start(self._start, self.world, self.area, self.robot, self.np_random)
        simulator_rng, localizer_rng = self.np_random.spawn(2)
        self._stand(self.world, start, simulator_rng)
        self.odometry.reset(self.reading)
        grid = known_map(self.area) if self._map is None else self._map
        self._tell_start(grid, start, localizer_rng)
        self.estimate = self.localizer.estimate
        self.belief = Belief(self.estimate.pose, grid, NO_CELLS)
        """The estimated pose on the known map."""
        self.pyramid = MapPyramid(grid)
        self.trail = Trail()
        self._remember()
        self._twist = Twist(0.0, 0.0)
        goal = (options or {}).get("goal", self._goal)
        if isinstance(goal, str):
            goal = self.map_pose.between(draw_goal(self.area, start, self.np_random))
        self.set_goal(goal)
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(dict.fromkeys(NavigateRewards.names(), 0.0))

    def set_goal(self, goal: tuple[float, float, float]) -> None:
        """Set a further goal (x, y, theta), map frame, from where the robot is; the next step goes on towards it.

        Raises:
            ValueError: if the goal is not finite, or no place where the robot can stand.
        """
        if not is_pose(goal):
            raise ValueError(f"goal must be (x, y, theta), all finite, got {goal!r}")
        self.goal = Pose2D(*(float(k) for k in goal))
        """Where to go, map frame."""
        self._true_goal = self.map_pose.compose(self.goal)
        self._way = TrueWay(self.area, self._true_goal)
        self._way_left = self._way.length(self._state.pose)
        self.plan = None
        if self._time_limit is None:
            # Four times what the way takes at full speed, and as long again to find out where the robot is.
            usual = 30.0 + 4.0 * self._way_left / self.robot.max_v + 60.0 * (self._initial_pose == "unknown")
            self.time_limit = self.reading.time + 10.0 * round(0.1 * usual)

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1].
        """
        before = self._drive(action)
        self._update_belief(before)
        self._remember()

        way_before, self._way_left = self._way_left, self._way.length(self._state.pose)
        terminated = self._is_at_goal()
        truncated = not terminated and self._is_late
        gained = way_before - self._way_left
        rewards = self.weights.terms(gained, self.reading.bumper, terminated, self.control_period)
        info = self._info(rewards)
        if terminated or truncated:
            info["end_reason"] = "reached" if terminated else "time_limit"
        if self.render_mode == "human":
            self.render()
        return self._observe(), sum(rewards.values()), terminated, truncated, info

    def scene(self) -> NavigationScene:
        """Return this moment for drawing: the map with what the robot believes on it."""
        return NavigationScene(
            world=self.world,
            robot=self.robot,
            pose=self.map_pose.between(self._state.pose),
            estimated_pose=self.estimate.pose,
            is_lost=self.estimate.is_lost,
            particles=getattr(self.localizer, "particles", np.empty((0, 3))),
            grid=self.belief.grid,
            ranges=self.reading.ranges,
            trail=self.map_pose.inverse().transform(self._true_trail.positions),
            goal=self.goal,
            plan=self.plan,
            time=self.reading.time,
            collisions=self._collisions,
        )

    def _painter(self) -> Callable[[tuple[int, int]], Any]:
        from envs.rendering.navigation import NavigationPicture  # and with it pygame, only when something is drawn

        return NavigationPicture

    def _tell_start(self, grid: OccupancyGrid, start: Pose2D, rng: np.random.Generator) -> None:
        """Reset the localiser with what it may know of the start (world frame)."""
        if self._initial_pose == "unknown":
            self.localizer.reset(grid, None, rng)
            return
        pose = self.map_pose.between(start)
        std = np.array([INITIAL_STD, INITIAL_STD, INITIAL_STD_THETA])
        offset = std * rng.standard_normal(3)
        told = Pose2D(pose.x + offset[0], pose.y + offset[1], pose.theta + offset[2])
        cell = grid.cells(np.array(told[:2]))
        if isinstance(self.localizer, DeadReckoning) or not grid.contains(cell) or grid.data[tuple(cell)] != 0:
            told = pose
        self.localizer.reset(grid, told, rng, covariance=np.diag(std**2))

    def _is_at_goal(self) -> bool:
        to_goal = self._state.pose.between(self._true_goal)
        near, aligned = self._tolerances
        return distance(to_goal.x, to_goal.y) <= near and abs(to_goal.theta) <= aligned

    def _update_belief(self, pose_before: Pose2D) -> None:
        """Feed the new scan to the localiser, with the motion that it may know of."""
        motion = self.odometry.update(self.reading)
        self._twist = Twist(motion.x / self.control_period, motion.theta / self.control_period)
        if self.localizer_is_told_the_truth:
            motion = pose_before.between(self._state.pose)
        self.estimate = self.localizer.update(self.reading.ranges, motion)
        self.belief.pose = self.estimate.pose

    def _remember(self) -> None:
        if self.trail.append(self.belief.pose):
            self.pyramid.mark(self.belief.pose.x, self.belief.pose.y)

    def _observe(self) -> dict[str, np.ndarray]:
        elapsed = self.reading.time / self.time_limit
        seen = observe(self.robot, self.reading, self.belief.pose, self.pyramid, self._twist, self._action, elapsed)
        ahead = self.belief.pose.between(self.goal)
        away = distance(ahead.x, ahead.y)
        bearing = math.atan2(ahead.y, ahead.x)
        turns = [f(angle) for angle in (bearing, ahead.theta) for f in (math.cos, math.sin)]
        deviations = np.sqrt(np.diag(self.estimate.covariance))
        doubt = [math.hypot(deviations[0], deviations[1]), deviations[2] / math.pi, float(self.estimate.is_lost)]
        return {
            **seen,
            "goal": np.array([min(away / GOAL_RANGE, 1.0), *turns], dtype=np.float32),
            "doubt": np.clip(np.array(doubt, dtype=np.float32), 0.0, 1.0),
        }

    def _info(self, rewards: dict[str, float]) -> dict[str, Any]:
        pose = self._state.pose
        error = self.map_pose.compose(self.belief.pose).between(pose)
        return {
            "distance_to_goal": distance(pose.x - self._true_goal.x, pose.y - self._true_goal.y),
            "way_to_goal": self._way_left,
            "pose_error": np.array([distance(error.x, error.y), abs(error.theta)]),
            "is_lost": self.estimate.is_lost,
            "path_length": self._path_length,
            "collisions": self._collisions,
            "time": self.reading.time,
            "rewards": rewards,
            "is_success": self._is_at_goal(),
        }
