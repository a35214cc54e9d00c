import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np

from lidarnaut.envs.estimation import DeadReckoning, Estimator
from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.measures import REACH, Measure, barn_metric
from lidarnaut.envs.observations import NearGoal
from lidarnaut.envs.observations.positions import GOAL_MEMORY
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import ObservationPart
from lidarnaut.envs.transition import BY_PERSON

from . import reach_kernels as own_at
from .carrot import make_carrot
from .goals import GeodesicDistance, GoalBrief, GoalTask
from .reach_kernels import END_REASONS, measure_goal, update_goal, update_goals
from .starts import UnknownWorldBrief, UnknownWorldTask

CELL = 0.1
"""Approximate cell size of the geodesic distance field [m]."""
AIM_RANGE, AIM_STEP = 2.0, 0.5
"""If only the goal's bearing is known, controllers drive to an aim point `AIM_RANGE` [m] ahead of the robot in this
direction. The aim point is updated if it shifts by more than `AIM_STEP` [m]."""
BENCHMARK_LIMIT = 100.0
"""Time limit in BARN benchmark worlds [s]."""
BARN_SPEED = 2.0
"""Robot speed assumed in the ideal driving time of the BARN benchmark's score [m/s]."""
QUANTITIES = {
    "progress": own_at.PROGRESS,
    "time": own_at.TIME,
    "collision": own_at.COLLISION,
    "reached": own_at.SUCCESS,
    "clearance": own_at.CLEARANCE,
    "people": own_at.PEOPLE,
}
"""Reward terms and their indices in the task's state array."""
METRICS = {
    "distance_to_goal": own_at.DISTANCE,
    "geodesic_distance": own_at.LEFT,
    "progress": own_at.SHARE,
    "is_success": own_at.SUCCESS,
}
"""Metrics and their indices in the task's state array."""


@dataclass(kw_only=True, eq=False)
class ReachGoalBrief(GoalBrief, UnknownWorldBrief):
    """Brief of `ReachGoal`."""

    slam: Any = "odometry"
    goal_given: Literal["pose", "bearing"] = "pose"

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if self.goal_given not in ("pose", "bearing"):
            raise ValueError(f"goal_given must be 'pose' or 'bearing', got {self.goal_given!r}")
        super().attach(robot, control_period, physics)

    def _tolerance(self, has_heading: bool) -> float:
        tolerance = super()._tolerance(has_heading)
        if self.goal_given == "bearing" and tolerance < math.pi:
            raise ValueError("goal_given='bearing' does not give headings: set the goal (x, y), without a tolerance")
        return tolerance

    def make_estimator(self) -> Estimator:
        is_reckoned = isinstance(self.slam, str) and self.slam in ("odometry", "truth")
        return DeadReckoning() if is_reckoned else super().make_estimator()

    def default_observations(self) -> Sequence[str]:
        return ("scan_history", "goal", "motion")

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        return {"goal": partial(NearGoal, self.goal_given == "pose"), "carrot": partial(make_carrot, self)}

    def begin(self, simulator: Simulator, robots: Sequence[Robot]) -> None:
        self._aim = ORIGIN
        super().begin(simulator, robots)

    def tell_goal(self, pose: Pose2D) -> Pose2D:
        """Return the goal, map frame; if only its bearing is known, a point in this direction instead."""
        if self.goal_given == "pose":
            return self.goal
        bearing = math.atan2(self.goal.y - pose.y, self.goal.x - pose.x)
        aim = pose._replace(x=pose.x + AIM_RANGE * math.cos(bearing), y=pose.y + AIM_RANGE * math.sin(bearing))
        self._aim = aim if math.dist(aim[:2], self._aim[:2]) > AIM_STEP else self._aim
        return self._aim


@dataclass(kw_only=True, eq=False)
class ReachGoal(ReachGoalBrief, GoalTask, UnknownWorldTask):
    """Drive to a goal in an unknown world.

    ## Description
    A differential-drive robot with a 2D lidar drives past walls and people to a goal, without a map. The map frame is
    the start pose. The pose estimate is odometry; a `slam` adds observations of map and plan. Observations contain no
    ground truth by default.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits,
    approached with its maximum accelerations.

    ## Observation Space
    `Dict`, egocentric; `observations` selects the parts:

    | key | space | meaning |
    |---|---|---|
    | `scan_history` | `Box(0, 1, (270,), float32)` | minimum ranges of 90 sectors 0, 0.2 and 0.4 s ago, as 0.5 m / (distance to the footprint + 0.5 m); see `lidarnaut.envs.observations.ScanHistory` |
    | `goal` | `Box(-1, 1, (4,), float32)` | distance / 10 m (at most 1), cosine and sine of the bearing, 1 m / (1 m + distance); with `goal_given="bearing"` cosine and sine alone |
    | `motion` | `Box(-1, 1, (6,), float32)` | as in `Explore` |

    Optional parts: `carrot` (`Box(-1, 1, (3,))`), a point 0.8 m ahead on a planned path, see
    `lidarnaut.envs.tasks.carrot`; `{"carrot": {"path": "shortest"}}` takes the true shortest path, for training
    (policies are marked as using ground truth). `trajectories` (`Box(-inf, inf, (66, 8))`), predicted outcomes of 66
    twists (with `{"trajectories": {"fine": True}}` of 130), see `lidarnaut.envs.observations.Trajectories`.

    ## Rewards
    The sum of `info["rewards"]`: `progress` (1 per m of decrease of the true geodesic distance), `time` (-0.2 per s of
    duration), `collision` (-20 for contact, which ends the episode; with `contact="costs"` per s in contact), `reached`
    (10, once, at the goal), `clearance` (-0.4 per s at a gap of 0 to obstacles, falling linearly to 0 at 0.15 m),
    `people` (-0.6 per s likewise, for the nearest person, to 0 at 0.5 m). `reward` changes the weights.

    ## Starting State
    The robot is at rest. For `start` see `Explore`. `goal="random"` draws a collision-free goal at least `min_distance`
    away; `goal="world"` is the world's goal of the nearest spawn; a tuple `(x, y)` or `(x, y, theta)` is in the frame
    of the start. `reset(options={"goal": (x, y), "min_distance": ..., "world": ..., "start": ...})` sets one episode,
    `set_options` all further ones, `set_goal` a new goal without a reset.

    ## Episode End
    1. Termination: the robot's true base is within `goal_tolerance` and `heading_tolerance` of the goal.
    2. Termination: the robot touches anything, unless `contact="costs"`.
    3. Truncation: `time_limit` seconds have passed.

    ## Information
    Each step: `distance_to_goal` (true, straight) [m], `geodesic_distance` (true, around static obstacles) [m],
    `progress` (driven fraction), `pose_error` (position [m], heading [rad]), `path_length` [m], `collisions`
    (contacts), `time` [s], `rewards`, `is_success`; at the end also `end_reason` (`"reached"`, `"wall"`, `"person"` or
    `"time_limit"`), `at_fault` (contact, unless a faster person walked into the robot), `jerk` (mean of forward jerk)
    [m/s3] and `barn_metric` (see `lidarnaut.envs.measures.barn_metric`), with people also `hit_wall`, `hit_person`,
    `hit_by_person` (contacts), `intrusion_time` [s], `least_gap` [m] and `least_time_to_collision` [s]. With
    `randomize` also `randomized` (drawn values by name).

    ## Arguments
    The arguments of `LidarEnv`, `world`, `start`, `split`, `world_size`, `difficulty`, `num_worlds`, `map_resolution`
    and `reward` of `Explore`, and

    | argument | default | meaning |
    |---|---|---|
    | `slam` | `"odometry"` | source of the pose: `"odometry"` or `"truth"`, without a map, or a SLAM, also with parameters (`"graph?preset=cartographer"`), see `lidarnaut.envs.slam.make_slam` |
    | `goal` | `"random"` | see Starting State |
    | `goal_given` | `"pose"` | `"pose"`, or `"bearing"` without distance; then `pursuit`, `dwb`, `mppi` and the planned `carrot` aim at a point 2 m away in its direction, updated after 0.5 m |
    | `goal_tolerance` | `0.3` | distance from the goal that counts as reached [m] |
    | `heading_tolerance` | `None` | as in `Navigate`; the part `goal` does not show the heading |
    | `min_distance` | `1.0` | minimum distance from the start to a random goal [m] |
    | `contact` | `"ends"` | whether contact `"ends"` the episode or `"costs"` |

    ## Version History
    * v0: first version
    """

    measures: ClassVar[Sequence[Measure]] = REACH
    weights = dict(progress=1.0, time=-0.2, collision=-20.0, reached=10.0, clearance=-0.4, people=-0.6)

    needs_explorable = False
    contact: Literal["ends", "costs"] = "ends"

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if self.contact not in ("ends", "costs"):
            raise ValueError(f"contact must be 'ends' or 'costs', got {self.contact!r}")
        super().attach(robot, control_period, physics)

    @property
    def _own(self) -> np.ndarray:
        return self._rows.memory[GOAL_MEMORY][0]

    @property
    def end_reason(self) -> str | None:  # type: ignore[override]
        return END_REASONS[int(self._own[own_at.END])]

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        simulator.rows.remember(GOAL_MEMORY, own_at.SIZE)[:] = 0.0
        return super().reset(simulator, robots, rng, options)

    def _measure_path(self) -> float:
        own, row = self._own, self._rows.numbers[0]
        geodesic = GeodesicDistance(self.area, self._true_goal, max(1, round(CELL / self.area.walls.resolution)))
        self.arrays, grid = (geodesic.lengths,), geodesic.grid
        own[: own_at.TOLERANCE] = *self.goal[:2], *self._true_goal[:2]
        own[own_at.TOLERANCE], own[own_at.ENDS] = self.goal_tolerance, self.contact == "ends"
        own[own_at.TRUE_THETA], own[own_at.TURN] = self._true_goal.theta, self.heading_tolerance
        own[own_at.FIELD_X : own_at.LENGTH] = *grid.origin, grid.resolution
        measure_goal(row, own, self.arrays[0])
        own[own_at.LENGTH], own[own_at.END], own[own_at.SHARE] = own[own_at.LEFT], 0.0, own[own_at.SUCCESS]
        return float(own[own_at.LENGTH])

    def _usual_time(self, length: float) -> float:
        return super()._usual_time(length) if self._world.optimal_length is None else BENCHMARK_LIMIT

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        update_goal(simulator.rows.numbers, self._own, self.arrays[0], self._world.segments, self._world.circles)

    def update_rows(self, batch: Any) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray]:
        owns = batch.memory[GOAL_MEMORY]
        update_goals(batch.numbers, owns, batch.task_arrays[0], batch.surroundings, batch.active)
        quantities, metrics = ({name: owns[:, k] for name, k in names.items()} for names in (QUANTITIES, METRICS))
        return quantities, metrics, owns[:, own_at.END] > 0.0

    def quantities(self) -> dict[str, float]:
        own = self._own.tolist()
        return {name: own[k] for name, k in QUANTITIES.items()}

    def metrics(self) -> dict[str, Any]:
        own = self._own.tolist()
        metrics: dict[str, Any] = {name: own[k] for name, k in METRICS.items()}
        return metrics | {"is_success": metrics["is_success"] > 0.0}

    def final_metrics(self) -> dict[str, Any]:
        own, row = self._own, self._rows.numbers[0]
        length = self._world.optimal_length
        ideal = own[own_at.LENGTH] / self.robot.max_v if length is None else length / BARN_SPEED
        time = row["time"] - own[own_at.MOVED_AT]
        return {
            "at_fault": bool(own[own_at.END] > own_at.AT_GOAL and row["touched_by"] != BY_PERSON),
            "jerk": float(own[own_at.JERK] / max(row["steps"], 1.0)),
            "barn_metric": float(barn_metric(own[own_at.SUCCESS] > 0.0, time, ideal)),
        }
