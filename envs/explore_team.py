"""Several robots explore one place together, with one map."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from envs.coverage import Coverage, ExplorableArea, explorable_area, map_iou
from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.map_pyramid import MapPyramid
from envs.observation import observation_space, observe
from envs.rendering.scene import Scene
from envs.rewards import RewardWeights
from envs.robot_env import DrivenEnv, checked_action, choose_robot, choose_start, is_pose, read_start
from envs.robots import RobotParams
from envs.simulation import Twist, make_simulator
from envs.slam import Belief, GivenPoseSlam, TinySlam, make_slam
from envs.team import MateFilter, Member, draw_starts, observe_mates
from envs.worlds import World, world_sampler

MAX_ROBOTS = 4
"""Robots of a team at most."""


class ExploreTeamEnv(DrivenEnv):
    """Explore an unknown place with a team of lidar robots that share one map.

    ## Description
    `ExploreEnv` with one to four equal robots. They wake up near each other and know how they stand to each other, as in
    Umari and Mukhopadhyay (2017). Each keeps track of its own pose, by matching its scans to the map that all of them draw
    into. They see each other, and they bump into each other. What a robot takes for a mate, by the poses that they tell
    each other, it leaves out of the map. With one robot everything equals `ExploreEnv`.

    ## Action Space
    `Box(-1, 1, (num_robots, 2), float32)`: a row per robot, forward speed and yaw rate (counter-clockwise) as fractions
    of its limits.

    ## Observation Space
    `Dict`, a row per robot of what `ExploreEnv` shows, everything seen from that robot (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_robots, num_beams), float32)` | ranges, mates among what they hit |
    | `map_near` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 8 m x 8 m around each robot |
    | `map_far` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 32 m x 32 m around each robot |
    | `motion` | `Box(-1, 1, (num_robots, 6), float32)` | each robot's own motion, last action, bumper, share of the time limit passed |
    | `mates` | `Box(-1, 1, (num_robots, 4 * (num_robots - 1)), float32)` | four numbers for each of the others, in the order of their indices: how far ahead and to the left it believes to be, over 16 m, cosine and sine of its heading; only with two or more robots |

    Channel 2 of the maps shows where any of the robots has been.

    ## Rewards
    The sum of the terms in `info["rewards"]`, which are those of `ExploreEnv` for the team as a whole: `explored` (each
    cell once, whoever sees it), `time`, `collision` (for each robot that touches anything, mates included), `completed`.

    ## Starting State
    The robots stand still with an unknown map, whose frame begins where robot 0 starts. `start` says where that is, as in
    `ExploreEnv`; the others stand within 2 m of it, in its sight and 0.5 m apart, with any heading, or, where there is no
    room for that, further away, closer together, or out of its sight. One pose per robot, `((x, y, theta), ...)`, is
    taken as it is.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    ## Information
    Each step: `explored_fraction` (of the explorable area), `explored_area` [m2], `time` [s], `rewards` (terms),
    `is_success`, and per robot `pose_error` (shape (num_robots, 2): position [m], heading [rad]), `path_length` [m] and
    `collisions` (both shape (num_robots,)); at the end also `map_iou` and `end_reason` (`"covered"` or `"time_limit"`).

    ## Arguments
    Those of `ExploreEnv`, and

    | argument | default | meaning |
    |---|---|---|
    | `num_robots` | `2` | robots, 1 to 4 |

    ## Version History
    * v0: first version
    """

    def __init__(
        self,
        *,
        num_robots: int = 2,
        world: str | World = "turtlebot3_world",
        robot: str | RobotParams | None = None,
        physics: str = "bullet",
        slam: str = "tinyslam",
        control_hz: float = 10.0,
        time_limit: float | None = None,
        target_coverage: float = 0.99,
        start: Literal["random", "spawn"]
        | tuple[float, float, float]
        | Sequence[tuple[float, float, float]] = "random",
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
        if num_robots not in range(1, MAX_ROBOTS + 1):
            raise ValueError(f"num_robots must be a whole number from 1 to {MAX_ROBOTS}, got {num_robots!r}")
        if not 0 < target_coverage <= 1:
            raise ValueError(f"target_coverage must lie in (0, 1], got {target_coverage!r}")
        self.num_robots = num_robots
        self._start = _read_starts(start, num_robots)
        self.weights = RewardWeights.of(reward)
        self._sample_world = world_sampler(world, split=split, size=world_size)
        super().__init__(
            robot=choose_robot(robot, world), control_hz=control_hz, time_limit=time_limit, render_mode=render_mode
        )
        self.target_coverage = target_coverage
        self.resolution = map_resolution
        self.simulator = make_simulator(physics, self.robot, self.control_period, num_robots)
        self.slam_is_told_the_truth = slam == "truth"
        self.members = [Member(self.robot, self._make_slam(slam), self.control_period) for _ in range(num_robots)]
        self.plans: list[np.ndarray | None] = [None] * num_robots
        """Planned path of each robot for drawing, shape (n, 2), map frame [m]; set them from outside, `reset` clears
        them."""
        self._without_mates = MateFilter(self.robot)
        self.action_space = spaces.Box(-1.0, 1.0, (num_robots, 2), np.float32)
        self.observation_space: spaces.Space[Any] = self._observation_space()

    @property
    def beliefs(self) -> list[Belief]:
        """What each robot believes; the map in them is one and the same."""
        return [member.slam.belief for member in self.members]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the robots into a place that they do not know and return the first observation and info."""
        super().reset(seed=seed)
        self.world = self._sample_world(self.np_random)
        area = explorable_area(self.world, self.robot, self.resolution)
        starts = self._choose_starts(area)
        self.start = starts[0]
        """World pose of the map frame's origin: where robot 0 starts."""
        if self._time_limit is None:
            self.time_limit = area.usual_time_limit(self.robot.max_v)
        rngs = self.np_random.spawn(2 * self.num_robots)
        readings = self.simulator.reset(self.world, starts, rngs[::2])
        for member, reading, state in zip(self.members, readings, self.simulator.states, strict=True):
            member.stand(reading, state)
        shared_map = None
        for member, pose, rng in zip(self.members, starts, rngs[1::2], strict=True):
            member.slam.reset(rng, self.start.between(pose), shared_map)
            shared_map = member.slam.map
        self.coverage = Coverage(area, self.start)
        self.pyramid = MapPyramid(self.beliefs[0].grid)
        self._update_beliefs([Pose2D(0.0, 0.0, 0.0)] * self.num_robots)
        self.plans = [None] * self.num_robots
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(dict.fromkeys(RewardWeights.names(), 0.0))

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive all robots for one control period.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1].
        """
        action = checked_action(action, (self.num_robots, 2))
        readings = self.simulator.step(
            [Twist(float(v) * self.robot.max_v, float(w) * self.robot.max_w) for v, w in action]
        )
        motions = []
        for member, row, reading, state in zip(self.members, action, readings, self.simulator.states, strict=True):
            by_odometry, in_truth = member.drive(row, reading, state, self.control_period)
            motions.append(in_truth if self.slam_is_told_the_truth else by_odometry)
        gained = self._update_beliefs(motions)
        touching = sum(reading.bumper for reading in readings)
        terminated = self.coverage.explored_fraction >= self.target_coverage
        truncated = not terminated and self.time >= self.time_limit - 1e-6
        rewards = self.weights.terms(gained, touching, terminated, self.control_period)
        info = self._info(rewards)
        if terminated or truncated:
            info["map_iou"] = map_iou(self.beliefs[0].grid, self.coverage.area, self.start)
            info["end_reason"] = "covered" if terminated else "time_limit"
        if self.render_mode == "human":
            self.render()
        return self._observe(), sum(rewards.values()), terminated, truncated, info

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.members[0].reading.time

    def scene(self) -> Scene:
        """Return this moment for drawing: the truth beside what the robots believe."""
        first, *mates = (self._scene_of(member, plan) for member, plan in zip(self.members, self.plans, strict=True))
        first.peers = tuple(mates)
        return first

    def close(self) -> None:
        """Release the physics engine and the window."""
        self.simulator.close()
        super().close()

    def _painter(self) -> None:
        """Paint with what the renderer paints with anyway."""

    def _make_slam(self, name: str) -> TinySlam | GivenPoseSlam:
        slam = make_slam(name, self.robot.lidar, self.resolution)
        if not isinstance(slam, TinySlam | GivenPoseSlam):
            raise ValueError(f"slam {name!r} cannot share a map; choose tinyslam, odometry or truth")
        return slam

    def _observation_space(self) -> spaces.Dict:
        num = self.num_robots
        batched = batch_space(observation_space(self.robot), num)
        assert isinstance(batched, spaces.Dict)
        parts = dict(batched.spaces)
        if num > 1:
            # Two axes: stable-baselines3 takes whatever has three for an image.
            parts["mates"] = spaces.Box(-1.0, 1.0, (num, 4 * (num - 1)), np.float32)
        return spaces.Dict(parts)

    def _choose_starts(self, area: ExplorableArea) -> list[Pose2D]:
        """Return where the robots start, world frame."""
        place = (self.world, area, self.robot, self.np_random)
        if isinstance(self._start, list):
            return [choose_start(pose, *place) for pose in self._start]
        first = choose_start(self._start, *place)
        return draw_starts(area, self.world, self.robot, first, self.num_robots, self.np_random)

    def _update_beliefs(self, motions: Sequence[Pose2D]) -> float:
        """Feed the new scans to the SLAMs, one after the other, each with the motion that it may know of.

        Returns:
            Area that became truly known [m2].
        """
        gained = 0.0
        # Where mates believe to be: by odometry until it is their turn, then by their scan as well.
        poses = [belief.pose.compose(motion) for belief, motion in zip(self.beliefs, motions, strict=True)]
        for k, (member, motion) in enumerate(zip(self.members, motions, strict=True)):
            ranges = self._without_mates(member.reading.ranges, poses[k], _others(poses, k))
            belief = member.slam.update(ranges, motion)
            poses[k] = belief.pose
            # At once: the next robot's scan may make the map grow, and its cells count from the corner.
            gained += self.coverage.update(belief)
            self.pyramid.update(belief.touched, np.concatenate([mate.trail.positions for mate in self.members]))
            if member.trail.append(belief.pose):
                self.pyramid.mark(belief.pose.x, belief.pose.y)
        return gained

    def _observe(self) -> dict[str, np.ndarray]:
        elapsed = self.time / self.time_limit
        poses = [belief.pose for belief in self.beliefs]
        views = [
            observe(self.robot, member.reading, pose, self.pyramid, member.twist, member.action, elapsed)
            for member, pose in zip(self.members, poses, strict=True)
        ]
        observation = {key: np.stack([view[key] for view in views]) for key in views[0]}
        if self.num_robots > 1:
            seen = [observe_mates(pose, _others(poses, k)) for k, pose in enumerate(poses)]
            observation["mates"] = np.stack(seen).reshape(len(seen), -1)
        return observation

    def _info(self, rewards: dict[str, float]) -> dict[str, Any]:
        errors = [self.start.compose(member.slam.belief.pose).between(member.state.pose) for member in self.members]
        fraction = self.coverage.explored_fraction
        return {
            "explored_fraction": fraction,
            "explored_area": self.coverage.explored_area,
            "pose_error": np.array([(distance(error.x, error.y), abs(error.theta)) for error in errors]),
            "path_length": np.array([member.path_length for member in self.members]),
            "collisions": np.array([member.collisions for member in self.members], dtype=np.int64),
            "time": self.time,
            "rewards": rewards,
            "is_success": fraction >= self.target_coverage,
        }

    def _scene_of(self, member: Member, plan: np.ndarray | None) -> Scene:
        return Scene(
            world=self.world,
            robot=self.robot,
            pose=member.state.pose,
            start=self.start,
            belief=member.slam.belief,
            ranges=member.reading.ranges,
            trail=member.true_trail.positions,
            estimated_trail=member.trail.positions,
            plan=plan,
            explored_fraction=self.coverage.explored_fraction,
            time=self.time,
            collisions=sum(mate.collisions for mate in self.members),
        )


def _others(poses: list[Pose2D], index: int) -> list[Pose2D]:
    return poses[:index] + poses[index + 1 :]


def _read_starts(start: Any, num_robots: int) -> str | Pose2D | list[Pose2D]:
    """Return the argument `start`: what `read_start` returns, or a pose per robot.

    Raises:
        ValueError: if it is none of them.
    """
    if isinstance(start, str) or is_pose(start):
        return read_start(start)
    try:
        poses = list(start)
    except TypeError:
        poses = []
    if len(poses) != num_robots or not all(is_pose(pose) for pose in poses):
        raise ValueError(
            f"start must be 'random', 'spawn', one pose (x, y, theta), or one for each of {num_robots} robots, "
            f"got {start!r}"
        )
    return [Pose2D(*(float(value) for value in pose)) for pose in poses]
