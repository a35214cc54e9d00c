"""Viewpoints all over a known map, the shortest paths between them, and what is seen from them."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from lidarnaut.baselines.frontier.tour import blocks_of
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.lines import cell_along, longest_step
from lidarnaut.envs.navigation import COST_INSCRIBED, COST_LETHAL, Costmap, travel_field
from lidarnaut.envs.navigation.astar import COST_WEIGHT, SCALE, STRAIGHT, UNREACHED, search, step_weights

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


def _spread_out(blocks: np.ndarray, steps: int) -> np.ndarray:
    """Choose blocks (row, column), the first ones first, of which no two are at most `steps` rows and columns apart."""
    neighbours = cKDTree(blocks).query_ball_point(blocks, steps, p=np.inf)
    chosen, taken = [], np.zeros(len(blocks), dtype=bool)
    for k in range(len(blocks)):
        if not taken[k]:
            chosen.append(k)
            taken[neighbours[k]] = True
    return blocks[chosen]


def _find_predecessors(
    from_origins: np.ndarray, lengths: np.ndarray, near: np.ndarray, origins: np.ndarray
) -> np.ndarray:
    """Find the predecessor of each viewpoint on the path from each origin, shape (m, n), int32; see `Viewpoints`.

    `from_origins`, shape (m, n), are the path lengths from the origins [m]. Where no viewpoint lies in between, an
    entry of `origins`, shape (m,), is the predecessor.
    """
    viewpoints = np.arange(len(near))
    onward = lengths[near, viewpoints[:, None]]
    predecessors = np.empty(from_origins.shape, dtype=np.int32)
    for row, (travelled, origin) in enumerate(zip(from_origins, origins)):
        through = travelled[near] + onward
        through[(travelled[near] >= travelled[:, None]) | (near == origin)] = np.inf
        best = through.argmin(axis=1)
        is_between = through[viewpoints, best] < DETOUR * travelled
        predecessors[row] = np.where(is_between, near[viewpoints, best], origin)
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
        """Find the shortest paths from a point in the frame of the map; None if they lead to no viewpoint.

        Returns their lengths to all viewpoints, shape (n,), float64 [m], and the predecessor of each, shape (n,),
        int32, n for the point itself.
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
    blocks = _spread_out(blocks, max(1, round(spacing / size)) - 1)
    cells = side * blocks + np.column_stack(np.divmod(best[tuple(blocks.T)], side))
    lengths = _path_lengths(block_costs, blocks, blocks, size)
    lengths = np.minimum(lengths, lengths.T)
    near = np.argsort(lengths, axis=1, kind="stable")[:, 1 : NUM_NEAR + 1].astype(np.int32)
    predecessors = _find_predecessors(lengths, lengths, near, np.arange(len(cells)))
    return Viewpoints(grid, cells, lengths, near, predecessors, block_costs, side)


@njit(cache=True, error_model="numpy")
def _add_bit(words, bit):
    if bit >= 0:
        words[bit >> 6] |= np.uint64(1) << np.uint64(bit & 63)


@njit(cache=True, error_model="numpy")
def _views(free, cells, reach, sample_of, num_words):
    """Follow straight lines from each cell's centre until they meet anything that is not free; see `views_from`.

    The lines end one cell apart on a circle, and are followed from cell to cell along their longer axis.
    """
    height, width = free.shape
    views = np.zeros((len(cells), num_words), dtype=np.uint64)
    num_lines = max(8, math.ceil(2.0 * math.pi * reach))
    for n in range(len(cells)):
        row, col = cells[n]
        _add_bit(views[n], sample_of[row, col])
        for k in range(num_lines):
            d_row, d_col = longest_step(2.0 * math.pi * k / num_lines)
            for step in range(1, int(reach / math.hypot(d_row, d_col)) + 1):
                i, j = cell_along(row, col, d_row, d_col, step)
                if i < 0 or j < 0 or i >= height or j >= width or not free[i, j]:
                    break
                _add_bit(views[n], sample_of[i, j])
    return views


def views_from(free: np.ndarray, cells: np.ndarray, reach: float, samples: np.ndarray) -> np.ndarray:
    """Tell which samples are seen from cells by a lidar that looks all around up to `reach` [cells].

    `free`: shape (height, width), bool; `cells`, `samples`: shapes (n, 2) and (s, 2), int64, (row, column). Returns
    shape (n, ceil(s / 64)), uint64: bit i % 64 of word i // 64 is set where sample i is seen.
    """
    sample_of = np.full(free.shape, -1, dtype=np.int32)
    sample_of[tuple(samples.T)] = np.arange(len(samples))
    views: np.ndarray = _views(free, np.ascontiguousarray(cells), float(reach), sample_of, -(-len(samples) // 64))
    return views


def pack_bits(flags: np.ndarray) -> np.ndarray:
    """Pack flags (shape (s,), bool) into words as `views_from` does: shape (ceil(s / 64),), uint64."""
    padded = np.pad(flags, (0, -len(flags) % 64))
    words: np.ndarray = np.packbits(padded, bitorder="little").view("<u8").astype(np.uint64)
    return words


def unpack_bits(words: np.ndarray, num_flags: int) -> np.ndarray:
    """Unpack what `pack_bits` has packed: shape (num_flags,), bool."""
    return np.unpackbits(words.astype("<u8").view(np.uint8), count=num_flags, bitorder="little").astype(bool)
