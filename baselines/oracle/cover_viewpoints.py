"""Viewpoints all over a known map, and the shortest paths between them."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit

from baselines.frontier.tour import blocks_of
from envs.geometry import OccupancyGrid
from envs.navigation import COST_INSCRIBED, COST_LETHAL, Costmap, travel_field
from envs.navigation.astar import COST_WEIGHT, SCALE, STRAIGHT, UNREACHED, search, step_weights

MAX_VIEWPOINTS = 900
"""Number of viewpoints that their spacing is chosen for."""
MIN_SPACING = 0.3
"""Least distance between viewpoints [m]."""
MAX_BLOCK = 4
"""Most cells along a side of the blocks over which paths are searched."""
NUM_NEAR = 12
"""Number of nearest viewpoints that count as a viewpoint's neighbours."""
DETOUR = 1.1
"""A viewpoint lies on the path between two others if the path through it is at most this many times as long."""


@njit(cache=True, error_model="numpy")
def _spread_out(costs, order, steps):
    """Choose blocks so that from each one a chosen one is at most `steps` steps away, and none are nearer together.

    Steps lead over blocks whose costs, shape (height, width), are not lethal. `order`, shape (n, 2), int64, holds the
    blocks (row, column), those to be preferred first; returns the chosen ones of them, shape (m, 2).
    """
    height, width = costs.shape
    taken = np.zeros((height, width), dtype=np.bool_)
    visit = np.full((height, width), -1, dtype=np.int64)
    queue = np.empty((height * width, 2), dtype=np.int64)
    chosen = np.empty(len(order), dtype=np.int64)
    num_chosen = 0
    for k in range(len(order)):
        if taken[order[k, 0], order[k, 1]]:
            continue
        chosen[num_chosen] = k
        num_chosen += 1
        queue[0] = order[k]
        visit[order[k, 0], order[k, 1]] = k
        first, end = 0, 1
        for _ in range(steps + 1):
            ring_end = end
            while first < ring_end:
                row, col = queue[first]
                first += 1
                taken[row, col] = True
                for r in range(max(row - 1, 0), min(row + 2, height)):
                    for c in range(max(col - 1, 0), min(col + 2, width)):
                        if visit[r, c] != k and costs[r, c] < COST_INSCRIBED:
                            visit[r, c] = k
                            queue[end, 0], queue[end, 1] = r, c
                            end += 1
    return order[chosen[:num_chosen]]


@njit(cache=True, error_model="numpy")
def _find_predecessors(from_origins, lengths, near, origins):
    """Find the predecessor of each viewpoint on the path from each origin, shape (m, n), int32; see `Viewpoints`.

    `from_origins`, shape (m, n), are the path lengths from the origins [m]. Where no viewpoint lies in between, an
    entry of `origins`, shape (m,), is the predecessor.
    """
    predecessors = np.empty(from_origins.shape, dtype=np.int32)
    for row in range(len(origins)):
        travelled = from_origins[row]
        for viewpoint in range(travelled.size):
            predecessors[row, viewpoint] = origins[row]
            least = DETOUR * travelled[viewpoint]
            for other in near[viewpoint]:
                through = travelled[other] + lengths[other, viewpoint]
                if travelled[other] < travelled[viewpoint] and through < least and other != origins[row]:
                    predecessors[row, viewpoint], least = other, through
    return predecessors


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Viewpoints, and the shortest paths between them."""

    grid: OccupancyGrid
    """The map."""
    cells: np.ndarray
    """Shape (n, 2), int64, (row, column) of the viewpoints in the map."""
    lengths: np.ndarray
    """Shape (n, n), float64, finite, symmetric: lengths of the paths between viewpoints, weighted by costs [m]."""
    near: np.ndarray
    """Shape (n, k), int32: the nearest viewpoints of each, itself left out."""
    predecessors: np.ndarray
    """Shape (n, n), int32: `predecessors[i, j]` is the last viewpoint before j on the path from i, or i itself."""
    block_costs: np.ndarray
    """Costs of blocks of cells, uint8."""
    side: int
    """Side of a block [cells]."""

    @property
    def points(self) -> np.ndarray:
        """Positions of the viewpoints in the frame of the map, shape (n, 2) [m]."""
        return self.grid.centers(self.cells)

    def paths_from(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Find the shortest paths from a point in the frame of the map.

        Returns:
            Lengths of the paths to all viewpoints, shape (n,), float64 [m]; and the predecessor of each, shape (n,),
            int32, n for the point itself. None if no viewpoint can be reached from there.
        """
        block = _nearest_block(self.block_costs, self.grid.cells(np.array([x, y])) // self.side)
        if block is None:
            return None
        lengths = _path_lengths(self.block_costs, [block], self.cells // self.side, self.side * self.grid.resolution)
        predecessors = _find_predecessors(lengths, self.lengths, self.near, np.array([len(self.cells)]))
        return lengths[0], predecessors[0]


def _nearest_block(block_costs: np.ndarray, middle: np.ndarray) -> np.ndarray | None:
    """Return the passable block (row, column) nearest to another one, at most three blocks away."""
    low = np.maximum(middle - 3, 0)
    window = block_costs[low[0] : max(middle[0] + 4, 0), low[1] : max(middle[1] + 4, 0)]
    blocks = np.argwhere(window < COST_INSCRIBED) + low
    if len(blocks) == 0:
        return None
    nearest: np.ndarray = blocks[np.argmin(((blocks - middle) ** 2).sum(axis=1))]
    return nearest


def _path_lengths(
    block_costs: np.ndarray, origins: Iterable[np.ndarray], blocks: np.ndarray, side: float
) -> np.ndarray:
    """Measure the paths from blocks (row, column) of a side [m] to others that can be reached: shape (m, n) [m]."""
    weights = step_weights(COST_WEIGHT, False)
    travel = (search(block_costs, weights, row, col, -1, -1)[0][1:-1, 1:-1] for row, col in origins)
    costs_to_come = np.array([costs[tuple(blocks.T)] for costs in travel])
    assert (costs_to_come != UNREACHED).all()
    return costs_to_come * (side / (STRAIGHT * SCALE))


def find_viewpoints(costmap: Costmap, start: tuple[float, float]) -> Viewpoints | None:
    """Spread viewpoints over all of a known map that a robot at (x, y) [m] can reach; None if it is walled in."""
    field = travel_field(costmap, start)
    if field is None:
        return None
    grid = costmap.grid
    passable = (field.travel[1:-1, 1:-1] != UNREACHED) & (costmap.costs < COST_INSCRIBED)
    # Blocks of this side do not join what a wall divides: the robot cannot be that near to one.
    side = min(max(1, int(0.9 * costmap.params.robot_radius / grid.resolution)), MAX_BLOCK)
    cells = blocks_of(np.where(passable, costmap.costs, np.uint8(COST_LETHAL)), side, COST_LETHAL)
    block_costs, best = cells.min(axis=2), cells.argmin(axis=2)
    first = _nearest_block(block_costs, grid.cells(np.array(start)) // side)
    if first is None:
        return None
    travel, _ = search(block_costs, step_weights(COST_WEIGHT, False), first[0], first[1], -1, -1)
    block_costs[travel[1:-1, 1:-1] == UNREACHED] = COST_LETHAL
    blocks = np.argwhere(block_costs < COST_INSCRIBED)
    size = side * grid.resolution
    spacing = max(MIN_SPACING, size * np.sqrt(len(blocks) / MAX_VIEWPOINTS))
    # Viewpoints away from walls come first; nearness in four classes, so that they still form a lattice.
    blocks = blocks[np.argsort(block_costs[tuple(blocks.T)] // 64, kind="stable")]
    blocks = _spread_out(block_costs, blocks, max(1, round(spacing / size)) - 1)
    cells = side * blocks + np.column_stack(np.divmod(best[tuple(blocks.T)], side))
    lengths = _path_lengths(block_costs, blocks, blocks, size)
    lengths = np.minimum(lengths, lengths.T)
    near = np.ascontiguousarray(np.argsort(lengths, axis=1, kind="stable")[:, 1 : NUM_NEAR + 1].astype(np.int32))
    predecessors = _find_predecessors(lengths, lengths, near, np.arange(len(cells)))
    return Viewpoints(grid, cells, lengths, near, predecessors, block_costs, side)
