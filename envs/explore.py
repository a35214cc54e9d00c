"""The exploration environment: drive, map, and be rewarded for what is explored."""

from collections.abc import Mapping
from typing import Any, Literal

from envs.arguments import check_positive, choose_robot
from envs.core import LidarEnv, make_robots
from envs.estimation import Estimator
from envs.geometry import Pose2D
from envs.observations import Observations
from envs.randomization import Ranges
from envs.rendering.scene import Scene
from envs.robots import RobotParams
from envs.slam import DEFAULT_SLAM, PoseGraphView, make_slam
from envs.tasks.coverage import Coverage
from envs.tasks.explore import Explore
from envs.tasks.return_home import ExploreAndReturn
from envs.tasks.rewards import RewardWeights
from envs.worlds import World

OBSERVATIONS = ("scan", "map_near", "map_far", "motion")
"""Parts of an observation by default."""


class ExploreEnv(LidarEnv):
    """Explore an unknown world with a lidar robot.

    ## Description
    A differential-drive robot with a 2D lidar and wheel encoders starts in a world that it has no map of. Each step drives
    it for one control period; then a SLAM turns the new scan and the motion by odometry into a map and a pose. The policy
    sees what the robot senses and estimates, never ground truth. The task is to explore the whole world.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits. Actions
    outside are an error, or clipped with `clip_actions=True`, as unbounded Gaussian policies need.

    ## Observation Space
    `Dict`, everything seen from the robot (fresh arrays each step); `observations` chooses the parts:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | map, 8 m x 8 m around the robot, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | map, 32 m x 32 m around the robot, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by odometry over the limits, last action (2), bumper pressed (0 or 1), time since the reset over 600 s (at most 1) |
    | `plan` (not by default) | `Box(-1, 1, (27,), float32)` | ways to the three frontiers that are worth most, nine numbers for each: directions 0.3 m, 0.6 m and 1.5 m ahead on the path (cosine, sine), cost, unknown area in view, 1; see `envs.observations.Plan` |

    Map channels: 0 occupied, 1 free, 2 where the robot has been by its own estimate. Axis 1 points forward, axis 2 to the left. Unknown is 0 in
    channels 0 and 1.

    ## Rewards
    The sum of the terms in `info["rewards"]`, weighted by `RewardWeights`: `explored` (area [m2] of
    explorable cells that became explored: the map knows the cell where it is, and the true scan that made it known, or a
    later one, has seen it; a map that is displaced or bent gains nothing), `time`, `collision`, `completed`.

    ## Starting State
    The robot is at rest and has no map yet. `start="random"` draws its pose uniformly over where it fits, clear of
    movers, `start="spawn"` takes the world's first spawn pose, a tuple `(x, y, theta)` is taken as it is. Procedural
    families draw a new world at each reset. `reset(options={"world": ..., "start": ...})` chooses for one episode.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    With `return_home=True` the target coverage ends exploration, not the episode: the robot is called back to its start,
    and termination is when it is within 0.3 m of it, by ground truth. The default observation then has a part `home`,
    `Box(-1, 1, (4,), float32)`: 1 once the robot is called back, distance to the start by its own estimate over 32 m,
    cosine and sine of the bearing; and the reward a term `returned`.

    ## Information
    Each step: `explored_fraction` (of the explorable area), `explored_area` [m2], `pose_error` (position [m],
    heading [rad]), `path_length` [m], `collisions` (contacts so far), `time` [s], `rewards` (terms), `is_success`; at the
    end also `map_iou`, `area_left` (explorable and unknown) [m2] and `end_reason` (`"covered"` or `"time_limit"`). With `return_home=True` each step also
    `returned` and `time_home` (since the robot was called back) [s]; `end_reason` is `"returned"` in place of `"covered"`,
    and `is_success` asks for both. With `randomize` each step also `randomized`: what the episode has drawn, by name.

    ## Arguments
    | argument | default | meaning |
    |---|---|---|
    | `world` | `"turtlebot3_world"` | library world, procedural family (`rooms`, `maze`, `warehouse`, `caves`, `wings`, `halls`), path of a world YAML or of a `map_server` YAML, or a `World` |
    | `robot` | `None` | library robot, path of a robot YAML, or `RobotParams`; `None` takes the world's usual robot |
    | `physics` | `"bullet"` | `"bullet"` (PyBullet) or `"kinematic"` |
    | `slam` | `"hector"` | `"hector"`, `"tinyslam"`, `"graph"` (loop closures) and `"gmapping"` for one robot, `"odometry"` (maps at the pose by odometry), `"truth"` (maps at the true pose), or a SLAM of your own, see `envs.slam.make_slam` |
    | `control_hz` | `10.0` | steps per second |
    | `time_limit` | `None` | length of an episode [s]; `None` gives a time that grows with the explorable area and the length of its corridors |
    | `target_coverage` | `0.99` | explored fraction that ends the episode |
    | `start` | `"random"` | see Starting State |
    | `split` | `"train"` | which seeds of a procedural family: `"train"` or `"test"` |
    | `world_size` | `None` | outer size (x, y) of a procedural world [m]; `None` leaves it to the family |
    | `reward` | `RewardWeights()` | weights, also as a mapping |
    | `map_resolution` | `0.05` | side of a map cell [m] |
    | `observations` | `("scan", "map_near", "map_far", "motion")` | parts of the observation, see `envs.observations.make_parts` |
    | `return_home` | `False` | whether the robot is to come back to its start after exploring, see Episode End; for one robot |
    | `randomize` | `None` | (low, high) by the name of a parameter of the robot, from which each episode draws the true robot's; see docs/training.md |
    | `clip_actions` | `False` | whether actions outside [-1, 1] are clipped |
    | `render_mode` | `None` | `"human"` or `"rgb_array"` |

    ## Version History
    * v0: first version
    """

    task: Explore
    num_robots = 1
    """How many robots explore together."""
    is_team = False
    """Whether actions and observations have an axis for the robots."""

    def __init__(
        self,
        *,
        world: str | World = "turtlebot3_world",
        robot: str | RobotParams | None = None,
        physics: str = "bullet",
        slam: Any = DEFAULT_SLAM,
        control_hz: float = 10.0,
        time_limit: float | None = None,
        target_coverage: float = 0.99,
        start: Literal["random", "spawn"] | tuple[float, float, float] = "random",
        split: Literal["train", "test"] = "train",
        world_size: tuple[float, float] | None = None,
        reward: RewardWeights | Mapping[str, float] = RewardWeights(),
        map_resolution: float = 0.05,
        observations: Observations = OBSERVATIONS,
        return_home: bool = False,
        randomize: Ranges | None = None,
        clip_actions: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments.

        Raises:
            ValueError: if an argument is not among the allowed values; the message names it and them.
        """
        check_positive(map_resolution=map_resolution)
        params = choose_robot(robot, world)
        if return_home and self.num_robots > 1:
            raise ValueError("return_home is for one robot, not for a team")
        if return_home and observations is OBSERVATIONS:
            observations = (*OBSERVATIONS, "home")
        self.return_home = return_home
        task = (ExploreAndReturn if return_home else Explore)(
            params,
            world=world,
            split=split,
            world_size=world_size,
            start=start,
            target_coverage=target_coverage,
            reward=reward,
            resolution=map_resolution,
            num_robots=self.num_robots,
        )
        simulator, robots = make_robots(
            params,
            physics,
            control_hz,
            lambda: self._make_estimator(slam, params, map_resolution),
            uses_truth=slam == "truth",
            num_robots=self.num_robots,
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
            is_team=self.is_team,
        )
        self.resolution = map_resolution
        self.slam = robots[0].estimator

    def _make_estimator(self, slam: Any, params: RobotParams, resolution: float) -> Estimator:
        estimator = make_slam(slam, params.lidar, resolution, odometry_noise=params.odometry.noise)
        if self.num_robots > 1 and not getattr(estimator, "shares_maps", False):
            raise ValueError(f"slam {slam!r} cannot share a map; choose hector, tinyslam, odometry or truth")
        return estimator

    @property
    def start(self) -> Pose2D:
        """World pose of the map frame's origin: where the first robot starts."""
        return self.task.map_pose

    @property
    def coverage(self) -> Coverage:
        """The true coverage."""
        return self.task.coverage

    @property
    def is_returning(self) -> bool:
        """Whether the robot is to come back to its start; with `return_home=True` alone."""
        return self.task.is_returning

    def call_back(self) -> None:
        """End exploration where no frontier is left, and call the robot back to its start.

        Raises:
            ValueError: without `return_home=True`.
        """
        if not isinstance(self.task, ExploreAndReturn):
            raise ValueError("the robot can be called back with return_home=True alone")
        self.task.call_back()

    @property
    def target_coverage(self) -> float:
        """Explored fraction that ends the episode."""
        return self.task.target_coverage

    def scene(self) -> Scene:
        """Return this moment for drawing: ground truth beside the robots' estimates."""
        first, *peers = (self._scene_of(k) for k in range(len(self.robots)))
        first.peers = tuple(peers)
        return first

    def _scene_of(self, k: int) -> Scene:
        robot, truth = self.robots[k], self.truths[k]
        pose_graph = getattr(robot.estimator, "pose_graph", None)
        return Scene(
            world=self.world,
            robot=robot.params,
            pose=truth.state.pose,
            start=self.start,
            belief=robot.belief,
            ranges=robot.reading.ranges,
            trail=truth.trail.positions,
            estimated_trail=robot.trail.positions,
            plan=self.plans[k],
            explored_fraction=self.coverage.explored_fraction,
            time=self.time,
            collisions=sum(other.collisions for other in self.robots),
            pose_graph=pose_graph if isinstance(pose_graph, PoseGraphView) else None,
        )
