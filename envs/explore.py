"""The exploration environment: drive, map, and earn what you truly get to know."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from envs.coverage import Coverage, ExplorableArea, explorable_area, map_iou
from envs.estimation.motion import make_motion_source
from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.map_pyramid import MapPyramid
from envs.observation import Trail, observation_space, observe
from envs.rendering.scene import Scene
from envs.rewards import RewardWeights
from envs.robot_env import RobotEnv, choose_robot, choose_start, read_start
from envs.robots import RobotParams
from envs.simulation import Twist
from envs.slam import make_slam
from envs.worlds import World, world_sampler


class ExploreEnv(RobotEnv):
    """Explore an unknown place with a lidar robot.

    ## Description
    A differential-drive robot with a 2D lidar and wheel encoders wakes up in a place it has no map of. Each step drives it
    for one control period; then a SLAM turns the new scan and the encoders' motion into a map and a pose. The policy
    sees what the robot senses and believes, never the truth. The task is to get to know the whole place.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, everything seen from the robot (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | believed map, 8 m x 8 m around the robot, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | believed map, 32 m x 32 m around the robot, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by odometry over the limits, last action (2), bumper pressed (0 or 1), share of the time limit passed |

    Map channels: 0 occupied, 1 free, 2 where the robot has been. Axis 1 points forward, axis 2 to the left. Unknown is 0 in
    channels 0 and 1.

    ## Rewards
    The sum of the terms in `info["rewards"]`, weighted by `RewardWeights`: `explored` (area [m2] of explorable cells whose
    counterpart in the map became known, each once, so that a map which drifts off the place earns nothing), `time`,
    `collision`, `completed`.

    ## Starting State
    The robot stands still with an unknown map. `start="random"` draws its pose uniformly over where it can stand,
    `start="spawn"` takes the world's first spawn pose, a tuple `(x, y, theta)` is taken as it is. Procedural families draw
    a new world at each reset.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `explored_fraction` (of the explorable area), `explored_area` [m2], `pose_error` (position [m],
    heading [rad]), `path_length` [m], `collisions` (contacts so far), `time` [s], `rewards` (terms), `is_success`; at the
    end also `map_iou` and `end_reason` (`"covered"` or `"time_limit"`).

    ## Arguments
    | argument | default | meaning |
    |---|---|---|
    | `world` | `"turtlebot3_world"` | library world, procedural family (`rooms`, `maze`, `warehouse`, `caves`), path of a world YAML or of a `map_server` YAML, or a `World` |
    | `robot` | `None` | library robot, path of a robot YAML, or `RobotParams`; `None` takes the world's usual robot |
    | `physics` | `"bullet"` | `"bullet"` (PyBullet) or `"kinematic"` |
    | `slam` | `"tinyslam"` | `"tinyslam"`, `"odometry"` (maps at the encoders' pose) or `"truth"` (maps at the true pose) |
    | `control_hz` | `10.0` | steps per second |
    | `time_limit` | `None` | length of an episode [s]; `None` gives a time that grows with the explorable area |
    | `target_coverage` | `0.99` | explored fraction that ends the episode |
    | `start` | `"random"` | see Starting State |
    | `split` | `"train"` | which seeds of a procedural family: `"train"` or `"test"` |
    | `world_size` | `None` | outer size (x, y) of a procedural world [m]; `None` leaves it to the family |
    | `reward` | `RewardWeights()` | weights, also as a mapping |
    | `map_resolution` | `0.05` | side of a map cell [m] |
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
        slam: str = "tinyslam",
        control_hz: float = 10.0,
        time_limit: float | None = None,
        target_coverage: float = 0.99,
        start: Literal["random", "spawn"] | tuple[float, float, float] = "random",
        split: Literal["train", "test"] = "train",
        world_size: tuple[float, float] | None = None,
        reward: RewardWeights | Mapping[str, float] = RewardWeights(),
        map_resolution: float = 0.05,
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        if not 0 < target_coverage <= 1:
            raise ValueError(f"target_coverage must lie in (0, 1], got {target_coverage!r}")
        self._start = read_start(start)
        self.weights = RewardWeights.of(reward)
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
        self.target_coverage = target_coverage
        self.resolution = map_resolution
        self.slam = make_slam(slam, self.robot.lidar, map_resolution)
        self.slam_is_told_the_truth = slam == "truth"
        self.odometry = make_motion_source(self.robot, self.control_period)
        self._next_place: tuple[World, ExplorableArea] | None = None
        self.observation_space: spaces.Space[Any] = observation_space(self.robot)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the robot into a place it does not know and return the first observation and info."""
        super().reset(seed=seed)
        if seed is not None:
            self._next_place = None
        self.world, area = self._next_place or self._draw_place()
        self._next_place = None
        self.start = choose_start(self._start, self.world, area, self.robot, self.np_random)
        """World pose of the map frame's origin: where the robot starts."""
        if self._time_limit is None:
            self.time_limit = area.usual_time_limit(self.robot.max_v)
        simulator_rng, slam_rng = self.np_random.spawn(2)
        self._stand(self.world, self.start, simulator_rng)
        self.odometry.reset(self.reading)
        self.slam.reset(slam_rng)
        self.belief = self.slam.update(self.reading.ranges, Pose2D(0.0, 0.0, 0.0))
        self.coverage = Coverage(area, self.start)
        self.coverage.update(self.belief)
        self.pyramid = MapPyramid(self.belief.grid)
        self.trail = Trail()
        self._remember()
        self._twist = Twist(0.0, 0.0)
        self.plan = None
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(dict.fromkeys(RewardWeights.names(), 0.0))

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1].
        """
        before = self._drive(action)
        self._update_belief(before)
        self._remember()

        gained = self.coverage.update(self.belief)
        terminated = self.coverage.explored_fraction >= self.target_coverage
        truncated = not terminated and self._is_late
        rewards = self.weights.terms(gained, self.reading.bumper, terminated, self.control_period)
        info = self._info(rewards)
        if terminated or truncated:
            info["map_iou"] = map_iou(self.belief.grid, self.coverage.area, self.start)
            info["end_reason"] = "covered" if terminated else "time_limit"
        if self.render_mode == "human":
            self.render()
        return self._observe(), sum(rewards.values()), terminated, truncated, info

    def prepare(self) -> None:
        """Draw the place of the next episode ahead of time; a `reset` with a seed throws it away."""
        self._next_place = self._next_place or self._draw_place()

    def scene(self) -> Scene:
        """Return this moment for drawing: the truth beside what the robot believes."""
        return Scene(
            world=self.world,
            robot=self.robot,
            pose=self._state.pose,
            start=self.start,
            belief=self.belief,
            ranges=self.reading.ranges,
            trail=self._true_trail.positions,
            estimated_trail=self.trail.positions,
            plan=self.plan,
            explored_fraction=self.coverage.explored_fraction,
            time=self.reading.time,
            collisions=self._collisions,
        )

    def _painter(self) -> None:
        """Paint with what the renderer paints with anyway."""

    def _draw_place(self) -> tuple[World, ExplorableArea]:
        world = self._sample_world(self.np_random)
        return world, explorable_area(world, self.robot, self.resolution)

    def _update_belief(self, pose_before: Pose2D) -> None:
        """Feed the new scan to the SLAM, with the motion that it may know of."""
        motion = self.odometry.update(self.reading)
        self._twist = Twist(motion.x / self.control_period, motion.theta / self.control_period)
        if self.slam_is_told_the_truth:
            motion = pose_before.between(self._state.pose)
        self.belief = self.slam.update(self.reading.ranges, motion)

    def _remember(self) -> None:
        self.pyramid.update(self.belief.touched, self.trail.positions)
        if self.trail.append(self.belief.pose):
            self.pyramid.mark(self.belief.pose.x, self.belief.pose.y)

    def _observe(self) -> dict[str, np.ndarray]:
        elapsed = self.reading.time / self.time_limit
        return observe(self.robot, self.reading, self.belief.pose, self.pyramid, self._twist, self._action, elapsed)

    def _info(self, rewards: dict[str, float]) -> dict[str, Any]:
        error = self.start.compose(self.belief.pose).between(self._state.pose)
        fraction = self.coverage.explored_fraction
        return {
            "explored_fraction": fraction,
            "explored_area": self.coverage.explored_area,
            "pose_error": np.array([distance(error.x, error.y), abs(error.theta)]),
            "path_length": self._path_length,
            "collisions": self._collisions,
            "time": self.reading.time,
            "rewards": rewards,
            "is_success": fraction >= self.target_coverage,
        }
