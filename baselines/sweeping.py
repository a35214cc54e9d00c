"""Sweeping of a known floor: lanes in the parts of a decomposition, tours around spanning trees, random bounces."""

import math
from collections.abc import Callable

import numpy as np
from scipy import ndimage

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.lines import resample
from lidarnaut.envs.navigation import COST_INSCRIBED, Costmap, GoalNavigator, GoalParams, is_path_valid, travel_field
from lidarnaut.envs.navigation.maps.obstacles import free_distance
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist
from lidarnaut.envs.tasks.coverage import Frame
from lidarnaut.envs.tasks.sweep import sweep

from .reactive import MIN_WALL_MARGIN, WallFollower

Patch = list[np.ndarray]
"""Alternative tours of a part of the floor: waypoints (row, column), shape (n, 2), int."""
MAX_PASSES = 6
"""Maximum number of passes; further ones find floor only by errors of the pose estimate."""
FINE_TOLERANCE = 0.6
"""Goal tolerance after the first pass [grid cells]; at a whole cell, the body stays away from the walls."""
OVERLAP = 0.5
"""Minimum overlap of neighbouring lanes [grid cells]."""
STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Steps (row, column) to the neighbours of a block, counter-clockwise."""


def boustrophedon(free: np.ndarray, width: int, start: tuple[int, int]) -> list[Patch]:
    """Return parallel lanes along the longer axis of each cell of a boustrophedon decomposition.

    Choset, "Coverage of Known Spaces: The Boustrophedon Cellular Decomposition" (2000), with slices of one row, and
    cells that also end at bends.

    Args:
        free: collision-free grid cells, shape (height, width), bool.
        width: maximum distance between lanes [grid cells].
        start: grid cell (row, column) of the robot.
    """
    cells: list[list[tuple[int, int, int]]] = []
    last: list[list[tuple[int, int, int]]] = []  # cells that reach the previous row
    for row, line in enumerate(np.diff(np.pad(free.astype(np.int8), ((0, 0), (1, 1))), axis=1)):
        runs = list(zip(np.flatnonzero(line == 1).tolist(), (np.flatnonzero(line == -1) - 1).tolist(), strict=True))
        above = [[cell for cell in last if cell[-1][1] <= b and a <= cell[-1][2]] for a, b in runs]
        last = []
        for (a, b), joined in zip(runs, above, strict=True):
            is_one = len(joined) == 1 and sum(cell is joined[0] for others in above for cell in others) == 1
            # At the bend of a corridor, the length of the runs more than doubles or halves.
            is_one = is_one and 0.5 < (b - a + 1) / (joined[0][-1][2] - joined[0][-1][1] + 1) < 2.0
            last.append(joined[0] if is_one else [])
            cells += [] if is_one else last[-1:]
            last[-1].append((row, a, b))
    # Small cells are left for the end.
    return [_zigzags(np.array(cell), width) for cell in cells if sum(b - a for _, a, b in cell) >= width**2]


def _zigzags(cell: np.ndarray, width: int) -> Patch:
    rows, first, last = cell.T
    lanes = [((row, a), (row, b)) for row, a, b in cell]
    if len(cell) > np.mean(last - first):
        columns = ((col, rows[(first <= col) & (col <= last)]) for col in range(first.min(), last.max() + 1))
        lanes = [((along[0], col), (along[-1], col)) for col, along in columns if len(along)]
    chosen = np.linspace(0, len(lanes) - 1, 1 + math.ceil((len(lanes) - 1) / width)).round().astype(int)
    tours = [np.vstack([lanes[k][:: (-1) ** (i + side)] for i, k in enumerate(chosen)]) for side in (0, 1)]
    return [*tours, *(tour[::-1] for tour in tours)]


def spiral(free: np.ndarray, width: int, start: tuple[int, int]) -> list[Patch]:
    """Return tours around spanning trees of blocks of 2 x 2 lanes; arguments as for `boustrophedon`.

    Gabriely and Rimon, "Spiral-STC: An On-line Coverage Algorithm of Grid Environments by a Mobile Robot" (2002).
    """
    size, patches = 2 * width, list[Patch]()
    fits = np.array(np.lib.stride_tricks.sliding_window_view(free, (width + 1, width + 1)).all(axis=(2, 3)))
    low, left = max(np.ndindex(size, size), key=lambda offset: np.sum(fits[offset[0] :: size, offset[1] :: size]))
    blocks = set(map(tuple, np.argwhere(fits[low::size, left::size]).tolist()))
    while blocks:
        block = root = min(blocks, key=lambda block: math.dist(block, (start[0] / size, start[1] / size)))
        branches, stack, corner, tour = set(), [(root, root, 0)], 0, list[tuple[int, int]]()
        while stack:
            found, parent, step = stack.pop()
            if found in blocks:
                blocks.remove(found)
                branches |= {(parent, step), (found, (step + 2) % 4)} if found != parent else set()
                for turn in ((step + k) % 4 for k in (2, 1, 0, 3)):
                    stack.append(((found[0] + STEPS[turn][0], found[1] + STEPS[turn][1]), found, turn))
        while not tour or (block, corner) != (root, 0):  # counter-clockwise around the tree
            row, col = low + block[0] * size, left + block[1] * size
            tour.append((row + width * (corner > 1), col + width * (corner in (1, 2))))
            if is_branch := (block, corner) in branches:
                block = block[0] + STEPS[corner][0], block[1] + STEPS[corner][1]
            corner = (corner + (3 if is_branch else 1)) % 4
        points = np.array([*tour, tour[0]])
        steps = np.diff(points, axis=0)
        patches.append([points[np.append((steps != np.roll(steps, 1, axis=0)).any(axis=1), True)]])
    return patches


class SweepNavigator(GoalNavigator):
    """Sweeps the floor of a known map in passes, until the episode ends or no floor is left.

    The first pass drives tours, the nearest first. Each further pass drives nearer to walls: lanes, then single cells,
    on floor that the previous pass has not swept by the pose estimate, which is inaccurate.
    """

    def __init__(self, make_tours: Callable[[np.ndarray, int, tuple[int, int]], list[Patch]]) -> None:
        """Create a policy; `make_tours`: a function such as `boustrophedon`."""
        super().__init__(GoalParams(goal_tolerance=0.1, max_recoveries=2))
        self._make_tours = make_tours

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._num_passes, self._patches, self._waypoints = 0, list[Patch](), list[tuple[float, float]]()
        self._driven: list[tuple[float, ...]] = []  # lines (x0, y0, x1, y1) of the pass [m]

    def act(self, reading: Reading, belief: Belief) -> Twist:
        pose = belief.pose
        if not self._num_passes and belief.is_lost:  # drives by the scan until AMCL has found the pose
            if self.goal is None:
                self.set_goal(pose[:2])
            return super().act(reading, belief)
        if not self._num_passes:
            self._follow_map(belief)
            self._position = pose[:2]
            self._advance(pose)
        self._driven.append((*self._position, *pose[:2]))
        self._mark(*self._driven[-1])
        self._position = pose[:2]
        twist = super().act(reading, belief)
        ((x, y),) = pose.inverse().transform(np.array([self.target or self._position]))
        is_at_wall = self._attempt.has_path and twist.v <= 0.0 and 4.0 * abs(y) < x < 2.0 * self._robot.radius
        if is_at_wall or self.end_reason in ("arrived", "no_path", "stuck"):
            self._advance(pose)
        return twist

    def _advance(self, pose: Pose2D) -> None:
        num_passes = self._num_passes
        while not (self._waypoints or self._choose_tour(pose)):
            # One of two passes in succession sweeps all floor.
            if self._num_passes in (num_passes + 2, MAX_PASSES):
                self.end_reason = "no_floor_left"
                return
            self._begin_pass(pose)
        self.set_goal(self._waypoints.pop(0))

    def _begin_pass(self, pose: Pose2D) -> None:
        assert self.map is not None
        is_first, radius = not self._num_passes, self._robot.radius
        self._num_passes += 1
        self._costmap, self._grid = self.map.costmap(0 if is_first else 1, pose), self.map.grid
        field = travel_field(self._costmap, pose[:2])
        self._free = (self._costmap.costs < COST_INSCRIBED) & (False if field is None else np.isfinite(field.costs))
        self._unswept = self._near(self._free, radius)
        for line in self._driven:
            self._mark(*line)
        self._driven.clear()
        self._tolerance = self.params.goal_tolerance if is_first else FINE_TOLERANCE * self._grid.resolution
        rest = self._free if is_first else self._free & self._near(self._wide(), 0.5 * radius)
        make_tours = self._make_tours if is_first else boustrophedon
        width = max(1, int(2.0 * radius / self._grid.resolution - OVERLAP))
        self._patches = make_tours(rest, width, self.map.cell(*pose[:2]))

    def _near(self, floor: np.ndarray, reach: float) -> np.ndarray:
        return np.asarray(ndimage.distance_transform_edt(~floor) * self._grid.resolution <= reach)

    def _wide(self) -> np.ndarray:
        return np.asarray(ndimage.binary_opening(self._unswept, np.ones((3, 3), dtype=bool)))

    def _mark(self, *line: float) -> None:
        sweep(self._unswept, Frame(*self._grid.origin, self._grid.resolution), np.array([line]), self._robot.radius)

    def _choose_tour(self, pose: Pose2D) -> bool:
        field = travel_field(self._costmap, pose[:2]) if self._num_passes else None
        self._waypoints = [] if field is None else [(x, y) for x, y in self._grid.centers(self._next_tour(field.costs))]
        return bool(self._waypoints)

    def _next_tour(self, costs: np.ndarray) -> np.ndarray:
        if self._patches:
            tours = [(costs[tuple(tour[0])], k, tour) for k, patch in enumerate(self._patches) for tour in patch]
            _, k, tour = min(tours, key=lambda one: one[:2])
            del self._patches[k]
            return tour
        floors = () if self._num_passes == 1 else ((self._wide(), 0.5), (self._unswept, 0.5), (self._unswept, 1.0))
        for floor, reach in floors:
            rest = np.where(self._free & self._near(floor, reach * self._robot.radius), costs, np.inf)
            if math.isfinite(rest.min()):
                cell = np.array(np.unravel_index(rest.argmin(), rest.shape))
                self._mark(*self._grid.centers(cell), *self._grid.centers(cell))  # one visit is enough
                return cell[None]
        return np.empty((0, 2), dtype=int)

    def _plan(self, pose: Pose2D, costmap: Costmap, *, drive_out: bool) -> np.ndarray | None:
        line = resample(np.array([pose[:2], self.target]), costmap.grid.resolution)
        return line if is_path_valid(costmap, line) else super()._plan(pose, costmap, drive_out=drive_out)


class Bouncer(WallFollower):
    """Drives straight to a wall, turns by a random angle, and drives on."""

    def _command(self, obstacles: np.ndarray) -> Twist:
        robot = self._robot
        reach = 0.1 + 0.5 * robot.max_v**2 / robot.max_acc_v
        if free_distance(obstacles, 0.0, robot.radius + MIN_WALL_MARGIN, reach) >= reach:
            return self._drive(0.0)
        self._navigator.spin(self._rng.uniform(0.4, 1.6) * math.pi)
        return Twist(0.0, 0.0)
