import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.distance_transform import MAX_REACH, squared_distances
from lidarnaut.envs.robots import RobotParams

from .raster import rasterize
from .visibility import visible_from
from .world import World, kept_with_world


@dataclass(frozen=True, eq=False)
class ExplorableArea:
    """Cells of a world that one robot can reach and see, on a raster in the world frame."""

    walls: OccupancyGrid
    """Rasterized static geometry: 0 is free, 100 is occupied."""
    traversable: np.ndarray
    """Collision-free cells connected to the first spawn: shape of `walls`, bool."""
    start_cells: np.ndarray
    """Cells for random start positions, with one cell of extra clearance: shape of `walls`, bool."""
    near_people: np.ndarray
    """Cells in collision with people on fixed routes at time 0: shape of `walls`, bool."""
    name: str
    lidar_reach: float
    """Maximum range of the lidar [cells]."""

    @cached_property
    def explorable(self) -> np.ndarray:
        """Free cells that the lidar sees from traversable cells: shape of `walls`, bool. Computed at first access."""
        free = self.walls.data == 0
        pieces, num_pieces = ndimage.label(free, np.ones((3, 3), dtype=bool))
        touches = np.zeros(num_pieces + 1, dtype=bool)
        touches[pieces[self.traversable]] = True
        return visible_from(free, self.traversable, free & touches[pieces], self.lidar_reach, self.name)

    @property
    def area(self) -> float:
        """Size of the explorable area [m2]."""
        return float(np.count_nonzero(self.explorable)) * self.walls.resolution**2

    @property
    def corridor_length(self) -> float:
        """Estimated total corridor length: half the boundary length of the traversable cells [m].

        Uses Crofton's formula in four directions, with an error of at most 6 %.
        """
        t = self.traversable
        straight = np.count_nonzero(t[1:] != t[:-1]) + np.count_nonzero(t[:, 1:] != t[:, :-1])
        diagonal = np.count_nonzero(t[1:, 1:] != t[:-1, :-1]) + np.count_nonzero(t[1:, :-1] != t[:-1, 1:])
        return math.pi / 16.0 * (straight + diagonal / math.sqrt(2.0)) * self.walls.resolution

    def usual_time_limit(self, speed: float) -> float:
        """Return a time limit for exploration at `speed` [m/s], rounded to ten seconds [s].

        This is the longer of two times: covering the area twice in lanes of 1 m width, plus 120 s; or driving along all
        corridors at 0.4 `speed`, plus 60 s.
        """
        sweep = 120.0 + 10.0 * round(0.2 * self.area / speed)
        return max(sweep, 60.0 + 10.0 * round(0.25 * self.corridor_length / speed))

    def is_traversable(self, pose: Pose2D) -> bool:
        """Return True if the robot fits at `pose` (world frame) and can drive from there to the first spawn pose."""
        row, col = self.walls.cells(np.array([pose.x, pose.y]))
        return bool(self.walls.contains(np.array([row, col])) and self.traversable[row, col])

    def draw_pose(self, rng: np.random.Generator) -> Pose2D:
        """Sample a start pose uniformly, world frame; ValueError if people cover every start cell."""
        cells, blocked = np.flatnonzero(self.start_cells), self.near_people.ravel()
        if blocked[cells].all():
            raise ValueError(f"world {self.name!r} has no free pose: people block every start cell at time 0")
        cell = cells[rng.integers(len(cells))]
        while blocked[cell]:
            cell = cells[rng.integers(len(cells))]
        x, y = self.walls.centers(np.array(divmod(int(cell), self.start_cells.shape[1])))
        return Pose2D(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))


@kept_with_world
def explorable_area(world: World, robot: RobotParams, resolution: float) -> ExplorableArea:
    """Compute which cells of side `resolution` [m] a robot can reach and see in a world.

    Raises:
        ValueError: the robot does not fit at the first spawn pose.
    """
    walls = rasterize(world, resolution)
    free = walls.data == 0
    # The full distance transform takes half of a reset of a large world.
    reach = math.ceil(robot.radius / resolution) + 2
    if reach <= MAX_REACH:
        clearance = np.sqrt(squared_distances(~free, reach)) * resolution
    else:
        clearance = ndimage.distance_transform_edt(free) * resolution
    labels, _ = ndimage.label(clearance > robot.radius)
    row, col = walls.cells(np.array(world.spawns[0][:2]))
    label = labels[row, col]
    if label == 0:
        raise ValueError(
            f"robot {robot.name!r} (radius {robot.radius} m) does not fit at the first spawn of world {world.name!r}, "
            f"which has {clearance[row, col]:.3f} m of clearance at a resolution of {resolution} m; "
            "choose a smaller robot, another world or a finer map_resolution"
        )
    traversable = labels == label
    start_cells = traversable & (clearance > robot.radius + resolution)
    if not start_cells.any():
        start_cells = traversable
    near_people = np.zeros_like(free)
    rows, cols = np.ogrid[: free.shape[0], : free.shape[1]]
    xs, ys = (walls.origin[k] + resolution * (indices + 0.5) for k, indices in enumerate((cols, rows)))
    for person in world.people:
        x, y = person.waypoints[0]
        near_people |= np.hypot(xs - x, ys - y) <= robot.radius + person.radius
    lidar_reach = robot.lidar.range_max / resolution
    return ExplorableArea(walls, traversable, start_cells, near_people, world.name, lidar_reach)
