"""The exploration environment: drive, map, and earn what you truly get to know."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from envs.compilation import announce_compilation
from envs.coverage import Coverage, ExplorableArea, explorable_area, map_iou
from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.map_pyramid import MapPyramid
from envs.observation import Trail, observation_space, observe
from envs.robots import RobotParams, WheelOdometry, load_robot
from envs.simulation import Twist, make_simulator
from envs.simulation.sensors import measure_ranges
from envs.slam import make_slam
from envs.worlds import World, world_sampler

USUAL_ROBOTS = {
    "turtlebot3_house": "turtlebot3_waffle_pi",
    "tugbot_warehouse": "tugbot",
    "pimouse_arena": "raspimouse",
    "raspimouse_sample_maze": "raspimouse",
    "create3_maze": "create3",
}
"""Robot that a world is explored with when none is named; TurtleBot3 Burger everywhere else."""


@dataclasses.dataclass(frozen=True, slots=True)
class RewardWeights:
    """What a step is worth. The reward is the sum of the terms that `info["rewards"]` names."""

    explored: float = 1.0
    """For area that became truly known [1/m2]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    completed: float = 10.0
    """Once, when the target coverage is reached."""

    def __post_init__(self) -> None:
        for name, weight in dataclasses.asdict(self).items():
            if not math.isfinite(weight):
                raise ValueError(f"reward weight {name!r} must be finite, got {weight!r}")

    def terms(self, gained: Any, touching: Any, completed: Any, period: float) -> dict[str, Any]:
        """Return the reward terms of a step, or arrays of them.

        Args:
            gained: area that became truly known [m2].
            touching: whether the robot touched anything.
            completed: whether the target coverage is reached.
            period: length of the step [s].
        """
        return {
            "explored": self.explored * gained,
            "time": self.time * period,
            "collision": self.collision * period * touching,
            "completed": self.completed * completed,
        }


REWARD_TERMS = tuple(field.name for field in dataclasses.fields(RewardWeights))
"""Names of the reward's terms, in the order in which they are summed."""


class ExploreEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
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

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

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
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        if not (math.isfinite(control_hz) and control_hz > 0):
            raise ValueError(f"control_hz must be positive, got {control_hz!r}")
        if time_limit is not None and not time_limit > 0:
            raise ValueError(f"time_limit must be positive or None, got {time_limit!r}")
        if not 0 < target_coverage <= 1:
            raise ValueError(f"target_coverage must lie in (0, 1], got {target_coverage!r}")
        is_pose = not isinstance(start, str) and len(start) == 3 and all(map(math.isfinite, start))
        if not (is_pose or start in ("random", "spawn")):
            raise ValueError(f"start must be 'random', 'spawn' or (x, y, theta), got {start!r}")
        if not isinstance(reward, RewardWeights):
            if unknown := sorted(set(reward) - set(REWARD_TERMS)):
                raise ValueError(f"reward has unknown terms {unknown}; allowed are {list(REWARD_TERMS)}")
            reward = RewardWeights(**reward)
        announce_compilation(measure_ranges)
        self._sample_world = world_sampler(world, split=split, size=world_size)
        world_name = world if isinstance(world, str) else world.name
        self.robot = load_robot(USUAL_ROBOTS.get(world_name, "turtlebot3_burger") if robot is None else robot)
        self.control_period = 1.0 / control_hz
        self.time_limit = time_limit or math.inf
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(control_hz))}
        self.plan: np.ndarray | None = None
        """Planned path for drawing, shape (n, 2), map frame [m]; set it from outside, `reset` clears it."""
        self._time_limit = time_limit
        self.target_coverage = target_coverage
        self._start = start if isinstance(start, str) else Pose2D(*map(float, start))
        self.weights = reward
        self.resolution = map_resolution
        self.simulator = make_simulator(physics, self.robot, self.control_period)
        self.slam = make_slam(slam, self.robot.lidar, map_resolution)
        self.slam_is_told_the_truth = slam == "truth"
        self.odometry = WheelOdometry(self.robot)
        self._next_place: tuple[World, ExplorableArea] | None = None
        self._renderer: Any = None
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
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
        self._place(area)
        if self._time_limit is None:
            # Time to sweep the area twice with a swath of a metre at full speed, rounded to ten seconds.
            self.time_limit = 120.0 + 10.0 * round(0.2 * area.area / self.robot.max_v)
        simulator_rng, slam_rng = self.np_random.spawn(2)
        self.reading = self.simulator.reset(self.world, self.start, simulator_rng)
        self._state = self.simulator.state
        self.odometry.reset(self.reading.ticks)
        self.slam.reset(slam_rng)
        self.belief = self.slam.update(self.reading.ranges, Pose2D(0.0, 0.0, 0.0))
        self.coverage = Coverage(area, self.start)
        self.coverage.update(self.belief)
        self.pyramid = MapPyramid(self.belief.grid)
        self.trail = Trail()
        self._true_trail = Trail()
        self._remember()
        self._twist = Twist(0.0, 0.0)
        self._action = np.zeros(2, dtype=np.float32)
        self._path_length = 0.0
        self._collisions = 0
        self.plan = None
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(dict.fromkeys(REWARD_TERMS, 0.0))

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1].
        """
        self._action = self._checked(action)
        command = Twist(float(self._action[0]) * self.robot.max_v, float(self._action[1]) * self.robot.max_w)
        touching = self.reading.bumper
        self.reading = self.simulator.step(command)
        before, self._state = self._state, self.simulator.state
        self._update_belief(before.pose)
        self._remember()
        self._path_length += distance(self._state.pose.x - before.pose.x, self._state.pose.y - before.pose.y)
        self._collisions += self.reading.bumper and not touching

        gained = self.coverage.update(self.belief)
        terminated = self.coverage.explored_fraction >= self.target_coverage
        truncated = not terminated and self.reading.time >= self.time_limit - 1e-6
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

    def render(self) -> np.ndarray | None:
        """Draw the truth beside what the robot believes; an array (height, width, 3), uint8, for `rgb_array`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode; pass one to gymnasium.make")
            return None
        from envs.rendering import Renderer, Scene

        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"])
        return self._renderer.draw(
            Scene(
                world=self.world,
                robot=self.robot,
                pose=self._state.pose,
                start=self.start,
                belief=self.belief,
                ranges=self.reading.ranges,
                trail=self._true_trail.positions,
                believed_trail=self.trail.positions,
                plan=self.plan,
                explored_fraction=self.coverage.explored_fraction,
                time=self.reading.time,
                collisions=self._collisions,
            )
        )

    def close(self) -> None:
        """Release the physics engine and the window."""
        self.simulator.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the window behind when pickled."""
        return {**self.__dict__, "_renderer": None}

    def _draw_place(self) -> tuple[World, ExplorableArea]:
        world = self._sample_world(self.np_random)
        return world, explorable_area(world, self.robot, self.resolution)

    def _place(self, area: ExplorableArea) -> None:
        """Choose the start pose."""
        if self._start == "random":
            self.start = area.draw_pose(self.np_random)
            return
        self.start = self.world.spawns[0] if self._start == "spawn" else self._start
        if not area.can_stand(self.start):
            raise ValueError(
                f"start {tuple(self.start)} is no place where robot {self.robot.name!r} (radius {self.robot.radius} m) "
                f"can stand in world {self.world.name!r}; its spawns are {[tuple(pose) for pose in self.world.spawns]}"
            )

    def _checked(self, action: np.ndarray) -> np.ndarray:
        action = np.array(action, dtype=np.float32)
        if action.shape != (2,):
            raise ValueError(f"action must have shape (2,), got {action.shape}")
        if not (np.abs(action) <= 1.0).all():
            raise ValueError(f"action must be finite and lie in [-1, 1], got {action}")
        return action

    def _update_belief(self, pose_before: Pose2D) -> None:
        """Feed the new scan to the SLAM, with the motion that it may know of."""
        motion = self.odometry.update(self.reading.ticks)
        self._twist = Twist(motion.x / self.control_period, motion.theta / self.control_period)
        if self.slam_is_told_the_truth:
            motion = pose_before.between(self._state.pose)
        self.belief = self.slam.update(self.reading.ranges, motion)

    def _remember(self) -> None:
        self.pyramid.update(self.belief.touched, self.trail.positions)
        if self.trail.append(self.belief.pose):
            self.pyramid.mark(self.belief.pose.x, self.belief.pose.y)
        self._true_trail.append(self._state.pose)

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
