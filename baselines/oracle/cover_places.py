"""Places to look from all over a known map, and the ways between them."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid
from envs.navigation import COST_INSCRIBED, COST_LETHAL, Costmap, travel_field
from envs.navigation.astar import COST_WEIGHT, SCALE, STRAIGHT, UNREACHED, search, step_weights

MAX_PLACES = 900
"""Number of places that the distance between them is chosen for."""
MIN_SPACING = 0.3
"""Least distance between places [m]."""
MAX_BLOCK = 4
"""Most cells along a side of the blocks over which ways are measured."""
NUM_NEAR = 12
"""Number of nearest places that count as a place's neighbours."""
DETOUR = 1.1
"""A place counts as one on the way between two others if the way past it is at most this many times as long."""


@njit(cache=True, error_model="numpy")
def _blocks(costs, passable, side):
    """Merge cells into blocks that are as good as their best cell.

    Args:
        costs: shape (height, width), uint8.
        passable: same shape, bool: where the robot can get.
        side: side of a block [cells].

    Returns:
        Costs of the blocks, uint8, lethal where no cell is passable; and their best cells, shape (..., 2), int64.
    """
    height, width = -(-costs.shape[0] // side), -(-costs.shape[1] // side)
    block_costs = np.full((height, width), np.uint8(COST_LETHAL), dtype=np.uint8)
    best_cells = np.zeros((height, width, 2), dtype=np.int64)
    for row in range(costs.shape[0]):
        for col in range(costs.shape[1]):
            i, j = row // side, col // side
            if passable[row, col] and costs[row, col] < block_costs[i, j]:
                block_costs[i, j] = costs[row, col]
                best_cells[i, j, 0], best_cells[i, j, 1] = row, col
    return block_costs, best_cells


@njit(cache=True, error_model="numpy")
def _spread_out(costs, order, steps):
    """Choose blocks so that from each one a chosen one is at most `steps` steps away, and none are nearer together.

    Args:
        costs: shape (height, width), uint8: steps lead over blocks that are not lethal.
        order: shape (n, 2), int64: (row, column) of the blocks, those to be preferred first.
        steps: number of steps.

    Returns:
        Indices into `order` of the chosen ones, shape (m,), int64.
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
    return chosen[:num_chosen]


@njit(cache=True, error_model="numpy")
def _ways_from(costs, weights, block, blocks):
    """Measure the ways from one block to some: shape (n,), int32, in the units of `search`."""
    travel, _ = search(costs, weights, block[0], block[1], -1, -1)
    ways = np.empty(len(blocks), dtype=np.int32)
    for k in range(len(blocks)):
        ways[k] = travel[blocks[k, 0] + 1, blocks[k, 1] + 1]
    return ways


@njit(cache=True, error_model="numpy")
def _ways_between(costs, weights, blocks):
    ways = np.empty((len(blocks), len(blocks)), dtype=np.int32)
    for k in range(len(blocks)):
        ways[k] = _ways_from(costs, weights, blocks[k], blocks)
    return ways


@njit(cache=True, error_model="numpy")
def _last_before(ways, lengths, near, before, origin):
    """Find the last place before each one on the way from an origin.

    Args:
        ways: shape (n,), float64: from the origin to each place [m].
        lengths: shape (n, n), float64, between places [m].
        near: shape (n, k), int32, neighbours.
        before: shape (n,), int32, written.
        origin: what stands in `before` where there is no place in between.
    """
    for place in range(ways.size):
        before[place] = origin
        least = DETOUR * ways[place]
        for other in near[place]:
            past = ways[other] + lengths[other, place]
            if ways[other] < ways[place] and past < least and other != origin:
                before[place], least = other, past


@njit(cache=True, error_model="numpy")
def _all_before(lengths, near, before):
    for k in range(lengths.shape[0]):
        _last_before(lengths[k], lengths, near, before[k], k)


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places to look from, and the ways between them."""

    grid: OccupancyGrid
    """The map."""
    cells: np.ndarray
    """Shape (n, 2), int64, (row, column) of the places in the map."""
    lengths: np.ndarray
    """Shape (n, n), float64, finite, symmetric: ways between places, nearness to obstacles made longer [m]."""
    near: np.ndarray
    """Shape (n, k), int32: the nearest places of each, itself left out."""
    before: np.ndarray
    """Shape (n, n), int32: `before[i, j]` is the last place before j on the way from i, or i itself."""
    block_costs: np.ndarray
    """Costs of blocks of cells, uint8."""
    side: int
    """Side of a block [cells]."""

    @property
    def points(self) -> np.ndarray:
        """Positions of the places in the frame of the map, shape (n, 2) [m]."""
        return self.grid.centers(self.cells)

    def ways_from(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Measure the ways from a point in the frame of the map.

        Returns:
            Lengths of the ways to all places, shape (n,), float64 [m]; and the last place before each, shape (n,),
            int32, n standing for the point itself. None if no place can be reached from there.
        """
        block = _nearest_block(self.block_costs, self.grid.cells(np.array([x, y])) // self.side)
        if block is None:
            return None
        ways = _ways_from(self.block_costs, step_weights(COST_WEIGHT, False), block, self.cells // self.side)
        lengths = _metres(ways, self.side * self.grid.resolution)
        before = np.empty(len(ways), dtype=np.int32)
        _last_before(lengths, self.lengths, self.near, before, len(ways))
        return lengths, before


def _nearest_block(block_costs: np.ndarray, middle: np.ndarray) -> np.ndarray | None:
    """Return the passable block (row, column) nearest to another one, at most three blocks away."""
    low = np.maximum(middle - 3, 0)
    window = block_costs[low[0] : max(middle[0] + 4, 0), low[1] : max(middle[1] + 4, 0)]
    blocks = np.argwhere(window < COST_INSCRIBED) + low
    if len(blocks) == 0:
        return None
    nearest: np.ndarray = blocks[np.argmin(((blocks - middle) ** 2).sum(axis=1))]
    return nearest


def _metres(ways: np.ndarray, side: float) -> np.ndarray:
    """Convert the units of `search` over blocks of a side [m]."""
    assert (ways != UNREACHED).all()
    return ways * (side / (STRAIGHT * SCALE))


def find_places(costmap: Costmap, start: tuple[float, float], max_places: int = MAX_PLACES) -> Places | None:
    """Spread places over all that a robot can reach.

    Args:
        costmap: the known map, with the robot's footprint.
        start: where the robot is (x, y), frame of the map [m].
        max_places: roughly how many places at most.

    Returns:
        The places; None if the robot's place is walled in.
    """
    field = travel_field(costmap, start)
    if field is None:
        return None
    grid = costmap.grid
    passable = (field.travel[1:-1, 1:-1] != UNREACHED) & (costmap.costs < COST_INSCRIBED)
    # Blocks of this side do not join what a wall divides: the robot cannot stand that near to one.
    side = min(max(1, int(0.9 * costmap.params.robot_radius / grid.resolution)), MAX_BLOCK)
    block_costs, best_cells = _blocks(costmap.costs, passable, side)
    first = _nearest_block(block_costs, grid.cells(np.array(start)) // side)
    if first is None:
        return None
    travel, _ = search(block_costs, step_weights(COST_WEIGHT, False), first[0], first[1], -1, -1)
    block_costs[travel[1:-1, 1:-1] == UNREACHED] = COST_LETHAL
    blocks = np.argwhere(block_costs < COST_INSCRIBED)
    size = side * grid.resolution
    spacing = max(MIN_SPACING, size * np.sqrt(len(blocks) / max_places))
    # Places away from walls come first; nearness in four classes, so that places still form a lattice.
    blocks = blocks[np.argsort(block_costs[tuple(blocks.T)] // 64, kind="stable")]
    blocks = blocks[_spread_out(block_costs, blocks, max(1, round(spacing / size)) - 1)]
    cells = best_cells[tuple(blocks.T)]
    ways = _metres(_ways_between(block_costs, step_weights(COST_WEIGHT, False), blocks), size)
    lengths = np.minimum(ways, ways.T)
    near = np.argsort(lengths, axis=1, kind="stable")[:, 1 : NUM_NEAR + 1].astype(np.int32)
    before = np.empty(lengths.shape, dtype=np.int32)
    _all_before(lengths, near, before)
    return Places(grid, cells, lengths, np.ascontiguousarray(near), before, block_costs, side)
