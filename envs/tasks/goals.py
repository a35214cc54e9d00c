import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lidarnaut.envs.arguments import check_positive, is_pose
from lidarnaut.envs.geometry import FREE, OCCUPIED, ORIGIN, UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.measures import GOAL, Measure
from lidarnaut.envs.navigation import COST_FREE, COST_LETHAL, Costmap, CostmapParams, TravelField, travel_field
from lidarnaut.envs.observations.positions import GOAL_MEMORY
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import Brief
from lidarnaut.envs.worlds import ExplorableArea, World, load_map
from lidarnaut.envs.worlds.world import kept_with_world

from .starts import WorldTask

HEADING_TOLERANCE = 0.25
"""Default heading tolerance of a goal given with a heading, as Nav2's `yaw_goal_tolerance` [rad]."""


@dataclass(kw_only=True, eq=False)
class GoalBrief(Brief):
    """Base class of briefs with a goal to drive to, which need not be reachable."""

    has_goal = False
    """Whether a goal is given; otherwise, that of a real robot is the origin of the map frame."""
    goal: Any = "random"
    """Goal: `"random"`, `"world"` (the world's own goal), or (x, y, theta) or (x, y), map frame. During an episode, the
    current goal."""
    goal_tolerance: float = 0.3
    """Maximum distance from a goal that counts as reached [m]."""
    heading_tolerance: float | None = None
    """Maximum heading difference that counts as reached [rad]; None for `HEADING_TOLERANCE` if the goal is given with a
    heading, and pi otherwise. During an episode, the tolerance of the current goal."""

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        check_positive(goal_tolerance=self.goal_tolerance)
        self._given_tolerance = self.heading_tolerance
        if self._given_tolerance is not None and not 0 < self._given_tolerance <= math.pi:
            raise ValueError(f"heading_tolerance must be None or lie in (0, pi], got {self._given_tolerance!r}")
        self._goal, self._goals = self.goal, np.zeros((1, 2))
        self.heading_tolerance = self._tolerance(False)
        if isinstance(read := self._read_goal(self.goal), Pose2D):
            GoalBrief._set_goal(self, read, has_heading=len(self.goal) > 2)
        super().attach(robot, control_period, physics)

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        self.goal = self.goal if self.has_goal else ORIGIN
        self._goals = simulator.rows.remember(GOAL_MEMORY, 2)
        self._goals[0] = self.goal[:2]
        return super().reset(simulator, robots, rng, options)

    def set_goal(self, goal: Sequence[float]) -> float:
        """Set a goal (x, y[, theta]), map frame; return a time limit [s]. ValueError if not finite or reachable."""
        if isinstance(goal, str):
            raise ValueError(f"goal must be (x, y[, theta]), all finite, got {goal!r}")
        read: Any = self._read_goal(goal)
        return self._set_goal(read, has_heading=len(goal) > 2)

    def _set_goal(self, goal: Pose2D, *, has_heading: bool = False) -> float:
        self.heading_tolerance = self._tolerance(has_heading)
        self.goal, self._goals[0], self.has_goal = goal, goal[:2], True
        return math.inf

    def _read_goal(self, goal: Any) -> str | Pose2D:
        if isinstance(goal, str) and goal in ("random", "world"):
            return goal
        needs_heading = self._given_tolerance is not None and self._given_tolerance < math.pi
        if is_pose(goal, 2) and not needs_heading:
            return Pose2D(float(goal[0]), float(goal[1]), 0.0)
        if not is_pose(goal):
            allowed = "(x, y, theta), as heading_tolerance asks for a heading," if needs_heading else "(x, y[, theta]),"
            raise ValueError(f"goal must be 'random', 'world' or {allowed} all finite, got {goal!r}")
        return Pose2D(*map(float, goal))

    def _tolerance(self, has_heading: bool) -> float:
        default = HEADING_TOLERANCE if has_heading else math.pi
        return default if self._given_tolerance is None else self._given_tolerance


@dataclass(kw_only=True, eq=False)
class GoalTask(GoalBrief, WorldTask):
    """Base class of tasks with a goal to drive to."""

    measures: ClassVar[Sequence[Measure]] = GOAL
    progress = "progress"
    reset_options: ClassVar[tuple[str, ...]] = ("goal", "min_distance")

    min_distance: float = 1.0
    """Minimum distance from the start to a random goal [m]."""

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        check_positive(min_distance=self.min_distance)
        super().attach(robot, control_period, physics)
        self.success_condition = f"the robot is within {self.goal_tolerance:g} m of its goal"

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        self._rows, self._true_pose = simulator.rows, self.starts[0]
        goal, self._min_distance = options.get("goal", self._goal), options.get("min_distance", self.min_distance)
        check_positive(min_distance=self._min_distance)
        read = self._read_goal(goal)
        if read == "random":
            return self._set_goal(self.map_pose.between(self._draw_goal(rng)))
        if read == "world":
            goals, spawns = self._world.goals, self._world.spawns
            if not goals:
                raise ValueError(f"world {self._world.name!r} has no goals; choose goal='random' or (x, y, theta)")
            nearest = min(range(len(spawns)), key=lambda k: math.dist(spawns[k][:2], self._true_pose[:2]))
            return self._set_goal(self.map_pose.between(goals[nearest]))
        return self.set_goal(goal)

    def _set_goal(self, goal: Pose2D, *, has_heading: bool = False) -> float:
        true_goal = self.map_pose.compose(goal)
        if not self.area.is_traversable(true_goal):
            raise ValueError(f"goal {tuple(goal)} (map frame) is not reachable by the robot")
        super()._set_goal(goal, has_heading=has_heading)
        self._true_goal = true_goal
        return 10.0 * round(0.1 * self._usual_time(self._measure_path()))

    def _draw_goal(self, rng: np.random.Generator) -> Pose2D:
        return draw_goal(self.area, self._true_pose, rng, self._min_distance)

    @abstractmethod
    def _measure_path(self) -> float:
        """Compute and return the length of the shortest path to the current goal [m]."""

    def _usual_time(self, length: float) -> float:
        return 30.0 + 4.0 * length / self.robot.max_v


def given_map(map: Any) -> OccupancyGrid | None:
    """Return the map of an argument `map`: a path, a map or None; ValueError for others."""
    if map is not None and not isinstance(map, str | Path | OccupancyGrid):
        raise ValueError(f"map must be a path, an OccupancyGrid or None, got {map!r}")
    return load_map(map) if isinstance(map, str | Path) else map


def given_frame(pose: Any, world: World | None = None) -> Pose2D:
    """Return the pose of a map's origin in the world frame, as the argument `map_pose` gives it.

    `pose`: (x, y, theta) [m, m, rad], or `"spawn"` for the first spawn of the world; ValueError for others.
    """
    if isinstance(pose, str) and pose == "spawn":
        return world.spawns[0] if world else ORIGIN
    if not is_pose(pose):
        raise ValueError(f"map_pose must be 'spawn' or (x, y, theta), all finite, got {pose!r}")
    return Pose2D(*map(float, pose))


def known_map(area: ExplorableArea) -> OccupancyGrid:
    """Return the map of a perfect exploration: all that the lidar can see."""
    walls = area.walls
    data = np.where(area.explorable, np.int8(FREE), np.int8(UNKNOWN))
    data[walls.data > 0] = OCCUPIED
    return OccupancyGrid(data, walls.resolution, walls.origin)


@kept_with_world
def _free_space(area: ExplorableArea, pooled: int) -> Costmap:
    free = np.pad(area.traversable, [(0, -size % pooled) for size in area.traversable.shape])
    free = np.logical_or.reduce([free[i::pooled, j::pooled] for i in range(pooled) for j in range(pooled)])
    side = pooled * area.walls.resolution
    grid = OccupancyGrid(np.where(free, np.int8(FREE), np.int8(OCCUPIED)), side, area.walls.origin)
    return Costmap(np.where(free, np.uint8(COST_FREE), np.uint8(COST_LETHAL)), grid, CostmapParams(side, side))


class GeodesicDistance:
    """True shortest path length to a goal around static obstacles."""

    def __init__(self, area: ExplorableArea, goal: Pose2D, pooled: int = 1) -> None:
        """Compute the distances of all cells to a reachable goal, world frame.

        `pooled` x `pooled` raster cells form one cell.
        """
        costmap = _free_space(area, pooled)
        self.grid = costmap.grid
        """Occupancy grid on which the geodesic distance is computed: 0 is free, 100 is occupied."""
        field = travel_field(costmap, goal[:2], cost_weight=0.0)
        assert field is not None
        self._field: TravelField = field
        self._last, self._origin = math.inf, (float(self.grid.origin[0]), float(self.grid.origin[1]))

    @property
    def lengths(self) -> np.ndarray:
        """Distances to the goal from all cells: shape (height, width), float32 [m]; inf outside free space."""
        return self._field.costs

    def length(self, pose: Pose2D) -> float:
        """Return the geodesic distance from a pose (world frame) to the goal [m].

        Outside free space, return the last distance in free space.
        """
        (x, y), side = self._origin, self.grid.resolution
        length = self._field.length(math.floor((pose[1] - y) / side), math.floor((pose[0] - x) / side))
        self._last = length if length < math.inf else self._last
        return self._last


def draw_goal(area: ExplorableArea, start: Pose2D, rng: np.random.Generator, min_distance: float = 1.0) -> Pose2D:
    """Draw a collision-free goal, world frame, at least `min_distance` [m] from `start` in a straight line.

    If 100 draws are nearer, return the farthest.
    """
    drawn: list[Pose2D] = []
    away = [0.0]
    while away[-1] < min_distance and len(drawn) < 100:
        drawn.append(area.draw_pose(rng))
        away.append(math.dist(drawn[-1][:2], start[:2]))
    return drawn[max(int(np.argmax(away)) - 1, 0)]
