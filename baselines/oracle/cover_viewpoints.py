import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.lines import cell_along, longest_step
from lidarnaut.envs.geometry.occupancy_grid import blocks_of
from lidarnaut.envs.navigation import COST_INSCRIBED, COST_LETHAL, Costmap, travel_field
from lidarnaut.envs.navigation.search.astar import COST_WEIGHT, SCALE, STRAIGHT, UNREACHED, search, step_weights

MAX_VIEWPOINTS = 900
MIN_SPACING = 0.3
"""Minimum distance between viewpoints [m]."""
MAX_BLOCK = 4
NUM_NEIGHBORS = 12
MAX_DETOUR_RATIO = 1.1


def _spread_out(blocks: np.ndarray, steps: int) -> np.ndarray:
    neighbours = cKDTree(blocks).query_ball_point(blocks, steps, p=np.inf)
    chosen, taken = [], np.zeros(len(blocks), dtype=bool)
    for k in range(len(blocks)):
        if not taken[k]:
            chosen.append(k)
            taken[neighbours[k]] = True
    return blocks[chosen]


def _find_predecessors(travel: np.ndarray, lengths: np.ndarray, near: np.ndarray, origins: np.ndarray) -> np.ndarray:
    viewpoints = np.arange(len(near))
    onward = lengths[near, viewpoints[:, None]]
    predecessors = np.empty(travel.shape, dtype=np.int32)
    for row, (travelled, origin) in enumerate(zip(travel, origins)):
        through = travelled[near] + onward
        through[(travelled[near] >= travelled[:, None]) | (near == origin)] = np.inf
        best = through.argmin(axis=1)
        is_between = through[viewpoints, best] < MAX_DETOUR_RATIO * travelled
        predecessors[row] = np.where(is_between, near[viewpoints, best], origin)
    return predecessors


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Viewpoints on a map, and the shortest paths between viewpoints."""

    grid: OccupancyGrid
    cells: np.ndarray
    """Map cells of the viewpoints (row, column), shape (n, 2), int64."""
    lengths: np.ndarray
    """Path lengths between viewpoints, weighted by traversal costs [m], shape (n, n), float64, finite, symmetric."""
    near: np.ndarray
    """Indices of the nearest viewpoints of each viewpoint, shape (n, k), int32."""
    predecessors: np.ndarray
    """Index of the last viewpoint before viewpoint j on the path from i, at [i, j]; shape (n, n), int32."""
    block_costs: np.ndarray
    """Coarse costmap for path search: lowest traversal cost in each block of `side` x `side` cells, shape (block rows,
    block columns), uint8."""
    side: int

    @property
    def points(self) -> np.ndarray:
        return self.grid.centers(self.cells)

    def paths_from(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the shortest paths from (x, y) [m] to all n viewpoints; None if no traversable cell is near (x, y).

        Paths are given by their lengths, shape (n,), float64 [m], and their last intermediate viewpoints, shape (n,),
        int32: viewpoint indices, n for none.
        """
        block = _nearest_block(self.block_costs, self.grid.cells(np.array([x, y])) // self.side)
        if block is None:
            return None
        lengths = _path_lengths(self.block_costs, [block], self.cells // self.side, self.side * self.grid.resolution)
        predecessors = _find_predecessors(lengths, self.lengths, self.near, np.array([len(self.cells)]))
        return lengths[0], predecessors[0]


def _nearest_block(block_costs: np.ndarray, middle: np.ndarray) -> np.ndarray | None:
    low = np.maximum(middle - 3, 0)
    window = block_costs[low[0] : max(middle[0] + 4, 0), low[1] : max(middle[1] + 4, 0)]
    blocks = np.argwhere(window < COST_INSCRIBED) + low
    if len(blocks) == 0:
        return None
    nearest: np.ndarray = blocks[np.argmin(((blocks - middle) ** 2).sum(axis=1))]
    return nearest


def _path_lengths(block_costs: np.ndarray, starts: Iterable[np.ndarray], blocks: np.ndarray, side: float) -> np.ndarray:
    weights = step_weights(COST_WEIGHT, False)
    travel = (search(block_costs, weights, row, col, -1, -1)[0][1:-1, 1:-1] for row, col in starts)
    costs_to_come = np.array([costs[tuple(blocks.T)] for costs in travel])
    assert (costs_to_come != UNREACHED).all()
    return costs_to_come * (side / (STRAIGHT * SCALE))


def find_viewpoints(costmap: Costmap, start: tuple[float, float]) -> Viewpoints | None:
    """Place viewpoints in the area reachable from `start` (x, y), world frame [m]; None if no cell is reachable."""
    field = travel_field(costmap, start)
    if field is None:
        return None
    grid = costmap.grid
    passable = (field.travel[1:-1, 1:-1] != UNREACHED) & (costmap.costs < COST_INSCRIBED)
    # Blocks below the robot's radius do not connect both sides of a wall.
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
    # Prefer viewpoints away from walls; four classes of cost keep a lattice.
    blocks = blocks[np.argsort(block_costs[tuple(blocks.T)] // 64, kind="stable")]
    blocks = _spread_out(blocks, max(1, round(spacing / size)) - 1)
    cells = side * blocks + np.column_stack(np.divmod(best[tuple(blocks.T)], side))
    lengths = _path_lengths(block_costs, blocks, blocks, size)
    lengths = np.minimum(lengths, lengths.T)
    near = np.argsort(lengths, axis=1, kind="stable")[:, 1 : NUM_NEIGHBORS + 1].astype(np.int32)
    predecessors = _find_predecessors(lengths, lengths, near, np.arange(len(cells)))
    return Viewpoints(grid, cells, lengths, near, predecessors, block_costs, side)


@njit(cache=True, error_model="numpy")
def _add_bit(words, bit):
    if bit >= 0:
        words[bit >> 6] |= np.uint64(1) << np.uint64(bit & 63)


@njit(cache=True, error_model="numpy")
def _views(free, cells, reach, sample_of, num_words):
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
    """Return the cells visible from viewpoints with a 360 degree lidar.

    `free`: mask of free cells, shape (height, width), bool. `cells`: viewpoints, shape (n, 2), `samples`: cells to
    observe, shape (s, 2), both (row, column), int64. `reach`: lidar range [cells].

    Returns:
        Visibility, shape (n, ceil(s / 64)), uint64: bit i % 64 of word i // 64 for sample i.
    """
    sample_of = np.full(free.shape, -1, dtype=np.int32)
    sample_of[tuple(samples.T)] = np.arange(len(samples))
    views: np.ndarray = _views(free, np.ascontiguousarray(cells), float(reach), sample_of, -(-len(samples) // 64))
    return views


def pack_bits(flags: np.ndarray) -> np.ndarray:
    """Pack flags into 64-bit words, lowest bit first, shape (ceil(s / 64),), uint64; `flags`: shape (s,), bool."""
    padded = np.pad(flags, (0, -len(flags) % 64))
    words: np.ndarray = np.packbits(padded, bitorder="little").view("<u8").astype(np.uint64)
    return words


def unpack_bits(words: np.ndarray, num_flags: int) -> np.ndarray:
    """Unpack 64-bit words, lowest bit first, into flags, shape (num_flags,), bool."""
    return np.unpackbits(words.astype("<u8").view(np.uint8), count=num_flags, bitorder="little").astype(bool)
