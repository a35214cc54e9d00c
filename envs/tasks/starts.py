"""Base classes of tasks: choice of world and start poses."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import check_positive, is_pose
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.navigation.frontiers.frontiers import is_visible
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.slam import DEFAULT_SLAM, base_name, make_slam
from lidarnaut.envs.task import Brief, Task
from lidarnaut.envs.worlds import ExplorableArea, World, explorable_area, world_sampler
from lidarnaut.envs.worlds.library import Split, WorldSampler, has_no_effects
from lidarnaut.envs.worlds.map_worlds import FREE_SPACE, area_around, class_at

START_DISTANCE = 2.0
"""Maximum start distance of teammates from the first robot [m]. Up to eight times larger in narrow spaces."""
START_GAPS = (0.5, 0.25, 0.1, 0.01)
"""Minimum gaps between robots at the start [m]; smaller gaps are tried if space is short."""


@dataclass(kw_only=True, eq=False)
class WorldTask(Task):
    """Base class of tasks with configurable worlds and start poses."""

    needs_explorable = True
    """True if the task uses the explorable area (visible to the lidar), which is then computed for each new world."""
    world: Any = "turtlebot3_world"
    """Library world, procedural family, path of a world YAML or `map_server` YAML, a `World`, or a list of these to
    draw from."""
    split: Split = "train"
    """Seeds of procedural worlds: `"train"`, `"validation"` or `"test"`, which have no world in common."""
    world_size: tuple[float, float] | None = None
    """Outer size (x, y) of a procedural world [m]; None for the family's default."""
    difficulty: float | None = None
    """Difficulty of worlds of the family `clutter`, from 0 to 1; None draws a value."""
    num_worlds: int | None = None
    """Number of different worlds of a procedural family; None for no limit."""
    start: Any = "random"
    """Start: `"random"`, `"spawn"`, a pose (x, y, theta), or one pose per robot; world frame [m, rad]."""
    map_resolution: float = Brief.map_resolution
    reward: Any = None
    """Changed weights of reward terms by name, or a subclass of `lidarnaut.envs.task.Rewards`."""

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        super().attach(robot, control_period, physics)
        check_positive(map_resolution=self.map_resolution)
        self._start = read_start(self.start, self.num_robots)
        self._sample = self._sampler(self.world)
        self._quantities: dict[str, float] = {}
        """Quantities of the last control period, for subclasses that compute them in `update`."""

    def _sampler(self, world: Any) -> WorldSampler:
        settings: dict[str, Any] = {"split": self.split, "size": self.world_size, "radius": self.robot.radius}
        return world_sampler(world, **settings, difficulty=self.difficulty, num_worlds=self.num_worlds)

    @property
    def sampler_ahead(self) -> Any:
        """Function that draws the world of the next episode in advance; None for world generators of the user."""
        is_own = getattr(self.draw_world, "__func__", None) is WorldTask.draw_world
        return self._sample if is_own and has_no_effects(self._sample) else None

    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        # Size and difficulty apply to worlds that accept them.
        drawn = (self._sample if world is None else self._sampler([world]))(rng)
        area = explorable_area(drawn, self.robot, self.map_resolution)
        if self.needs_explorable:
            _ = area.explorable  # worlds are drawn ahead of time
        return drawn

    def place(self, world: World, start: Any) -> World:
        """Return the world to use for a start pose.

        If `world` was built from a map, this is the world of the free map area around the first robot's start pose.
        """
        wanted = self._start if start is None else read_start(start, self.num_robots)
        return world if isinstance(wanted, str) else area_around(world, wanted[0])

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> list[Pose2D]:
        """Return start poses, world frame; ValueError for a given pose that is not collision-free.

        Robots without a given pose start near the first robot.
        """
        self._world, self.area = world, explorable_area(world, self.robot, self.map_resolution)
        robot, area = self.robot, self.area
        wanted = self._start if start is None else read_start(start, self.num_robots)
        if wanted == "random":
            chosen = [area.draw_pose(rng)]
        else:
            chosen = [world.spawns[0]] if isinstance(wanted, str) else wanted
            for pose in chosen:
                if not area.is_traversable(pose):
                    raise ValueError(
                        f"start {tuple(pose)} is not collision-free for robot {robot.name!r} (radius {robot.radius} m) "
                        f"in world {world.name!r}: it lies {_reason(area, world, robot, pose)}; spawns are "
                        f"{[tuple(spawn) for spawn in world.spawns]}"
                    )
        if len(chosen) < self.num_robots:
            chosen = draw_starts(area, world, robot, chosen[0], self.num_robots, rng)
        self.starts = chosen
        return chosen

    def quantities(self) -> dict[str, float]:
        return self._quantities


@dataclass(kw_only=True, eq=False)
class UnknownWorldBrief(Brief):
    """Base class of briefs without a given map: a SLAM maps the world, in the frame of the first robot's start."""

    slam: Any = DEFAULT_SLAM
    """SLAM algorithm: a name, object or function, see `lidarnaut.envs.slam.make_slam`."""
    map_resolution: float = Brief.map_resolution

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        super().attach(robot, control_period, physics)
        self.uses_true_motion = base_name(self.slam) == "truth"

    def make_estimator(self) -> Estimator:
        """Create the SLAM algorithm; ValueError if unknown, or unable to share a map in a team."""
        robot = self.robot
        slam = make_slam(self.slam, robot.lidar, self.map_resolution, odometry_noise=robot.odometry.noise)
        if self.num_robots > 1 and not slam.shares_maps:
            raise ValueError(f"slam {self.slam!r} cannot share a map; choose hector, tinyslam, odometry or truth")
        return slam


@dataclass(kw_only=True, eq=False)
class UnknownWorldTask(UnknownWorldBrief, WorldTask):
    """Base class of tasks without a given map."""

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> list[Pose2D]:
        starts = super().choose_starts(world, start, rng)
        self.map_pose = starts[0]
        return starts


def read_start(start: Any, num_robots: int = 1) -> str | list[Pose2D]:
    """Return the argument `start` after a check: "random", "spawn" or a list of poses; ValueError otherwise."""
    if isinstance(start, str) and start in ("random", "spawn"):
        return start
    poses = [start] if is_pose(start) else list(start) if isinstance(start, Iterable) else []
    if (is_pose(start) or len(poses) == num_robots) and all(map(is_pose, poses)):
        return [Pose2D(*map(float, pose)) for pose in poses]
    each = f", or one for each of {num_robots} robots" if num_robots > 1 else ""
    raise ValueError(f"start must be 'random', 'spawn', a pose (x, y, theta){each}, got {start!r}")


def _reason(area: ExplorableArea, world: World, robot: RobotParams, pose: Pose2D) -> str:
    if world.map is not None and (where := class_at(world.map, pose)) != FREE_SPACE:
        return where
    cell = area.walls.cells(np.array(pose[:2]))
    if not area.walls.contains(cell):
        return f"outside of the bounds {world.bounds}"
    gap = clearance(pose.x, pose.y, world.segments, world.circles)
    if area.walls.data[tuple(cell)] or gap <= robot.radius + area.walls.resolution:
        return f"in an obstacle, or only {max(gap, 0.0):.2f} m from one"
    return "in another area than the spawns, or inside an obstacle"


def draw_starts(
    area: ExplorableArea, world: World, robot: RobotParams, first: Pose2D, num_robots: int, rng: np.random.Generator
) -> list[Pose2D]:
    """Draw start poses of a team near the first robot, in its line of sight and apart from each other, world frame.

    Without enough space, starts may be out of sight, closer together or farther away. ValueError if there is no room.
    """
    starts, circles = [first], world.circles_at_start
    start_cells = area.walls.centers(np.argwhere(area.start_cells))
    away = np.hypot(*(start_cells - first[:2]).T)
    for must_see, gap, factor in product((True, False), START_GAPS, (1.0, 2.0, 4.0, 8.0)):
        if len(starts) == num_robots:
            break
        for x, y in rng.permutation(start_cells[away <= factor * START_DISTANCE]):
            if len(starts) == num_robots:
                break
            is_apart = all(math.hypot(x - pose.x, y - pose.y) >= 2.0 * robot.radius + gap for pose in starts)
            has_room = is_apart and clearance(x, y, world.segments, circles) > robot.radius
            ends = np.array([first[:2], (x, y)])
            if has_room and (not must_see or is_visible(area.walls.data, *area.walls.cells(ends).ravel())):
                starts.append(Pose2D(float(x), float(y), float(rng.uniform(-math.pi, math.pi))))
    if len(starts) < num_robots:
        room = f"{len(starts)} robots {robot.name!r} around the start {tuple(first)} in world {world.name!r}"
        raise ValueError(f"there is room for {room}, not for num_robots = {num_robots}")
    return starts
