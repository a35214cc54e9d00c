"""Tiled maps with copy-on-write.

A pool with reference counts stores tiles (square blocks of cells) in numbered slots. A map is an array of slot numbers.
A tile holds `TILE` x `TILE` cells of the finest resolution, then the coarser resolutions of the same square.
"""

from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import UNKNOWN

from ..matching.gauss_newton import at_level, neighbours

TILE_BITS = 5
TILE = 1 << TILE_BITS
"""Side of a map tile [cells of the finest resolution]."""
EMPTY = 0
"""Slot number of the tile of unknown cells, which all maps share and no scan changes."""


class TilePool(NamedTuple):
    """Storage of map tiles (square blocks of cells) in numbered slots."""

    words: np.ndarray
    """Packed cells (log-odds and scan number) of each tile, shape (capacity, cells), int32."""
    occupancy: np.ndarray
    """Occupancies of each tile, shape (capacity, cells), int8 [percent]."""
    references: np.ndarray
    """Number of maps that use each tile, shape (capacity,), int32; 0 for tile `EMPTY` (unknown cells)."""
    written: np.ndarray
    """Index of the last scan that changed each tile, shape (capacity,), int64."""
    free: np.ndarray
    """Stack of unused slot numbers, shape (capacity,), int32, with `num_free[0]` valid entries."""
    num_free: np.ndarray


@njit(cache=True, error_model="numpy")
def level_start(level):
    """Return the index of the first cell of a map resolution in a tile, which stores the finest resolution first."""
    whole = 4 << (2 * TILE_BITS)
    return (whole - (whole >> (2 * level))) // 3


def make_pool(capacity: int, num_levels: int) -> TilePool:
    """Create a pool for `capacity` map tiles that contains only the unknown tile."""
    cells = level_start(num_levels)
    words, occupancy = np.empty((capacity, cells), dtype=np.int32), np.empty((capacity, cells), dtype=np.int8)
    words[EMPTY], occupancy[EMPTY] = 0, UNKNOWN
    references, written = np.zeros(capacity, dtype=np.int32), np.zeros(capacity, dtype=np.int64)
    free = np.arange(capacity, 0, -1, dtype=np.int32) - 1  # low slots are used first
    return TilePool(words, occupancy, references, written, free, np.array([capacity - 1]))


def enlarge_pool(pool: TilePool) -> TilePool:
    """Return a copy of a tile pool with twice the capacity."""
    capacity, num_free = len(pool.words), int(pool.num_free[0])
    words, occupancy, references, written = (np.concatenate([each, np.zeros_like(each)]) for each in pool[:4])
    free = np.empty(2 * capacity, dtype=np.int32)
    free[:capacity] = np.arange(2 * capacity - 1, capacity - 1, -1)
    free[capacity : capacity + num_free] = pool.free[:num_free]
    return TilePool(words, occupancy, references, written, free, np.array([capacity + num_free]))


@njit(cache=True, error_model="numpy")
def own_tile(pool, index, tile, number):
    """Make a map tile writable, by a copy if other maps share it; return its slot number, or -1 if the pool is full.

    `index`: slot numbers of the map's tiles, shape (num_tiles,), int32. `number`: current scan, stored in
    `pool.written`.
    """
    slot = index[tile]
    if slot == EMPTY or pool.references[slot] > 1:
        if pool.num_free[0] == 0:
            return -1
        pool.num_free[0] -= 1
        copy = pool.free[pool.num_free[0]]
        pool.words[copy], pool.occupancy[copy] = pool.words[slot], pool.occupancy[slot]
        if slot != EMPTY:
            pool.references[slot] -= 1
        pool.references[copy], index[tile] = 1, copy
        slot = copy
    pool.written[slot] = number
    return slot


def copy_maps(pool: TilePool, index: np.ndarray, parents: np.ndarray) -> None:
    """Replace each map i by a copy of map `parents[i]`, with shared tiles.

    `index`: slot number of each map's tiles, shape (num_maps, num_tiles), int32. `parents`: shape (num_maps,), int64.
    """
    index[:] = index[parents]
    used = pool.references > 0
    pool.references[:] = np.bincount(index.ravel(), minlength=len(used))
    pool.references[EMPTY] = 0
    freed = np.flatnonzero(used & (pool.references == 0))
    pool.free[pool.num_free[0] : pool.num_free[0] + len(freed)] = freed
    pool.num_free[0] += len(freed)


class TileMap(NamedTuple):
    """Read-only map of a particle in tiles (square blocks of cells)."""

    occupancy: np.ndarray
    cells: int
    slots: np.ndarray
    tiles_wide: int


class _TileLevel(NamedTuple):
    occupancy: np.ndarray
    height: int
    width: int
    slots: np.ndarray
    tiles_wide: int
    cells: int
    bits: int
    start: int


@at_level.register(TileMap)
def _level_of_tiles(map, level):
    bits = TILE_BITS - level
    height, width = (map.slots.shape[0] // map.tiles_wide) << bits, map.tiles_wide << bits
    return _TileLevel(map.occupancy, height, width, map.slots, map.tiles_wide, map.cells, bits, level_start(level))


@njit(cache=True, error_model="numpy")
def _cell_at(view, row, col):
    mask = (1 << view.bits) - 1
    slot = view.slots[(row >> view.bits) * view.tiles_wide + (col >> view.bits)]
    return np.uint64(slot * view.cells + view.start + ((row & mask) << view.bits) + (col & mask))


@neighbours.register(_TileLevel)
def _neighbours_of_tiles(view, row, col):
    mask = (1 << view.bits) - 1
    corner = _cell_at(view, row, col)
    if row & mask != mask and col & mask != mask:
        above = corner + np.uint64(1 << view.bits)
        return corner, corner + np.uint64(1), above, above + np.uint64(1)
    # Clamped at the border, where only the first cell is used.
    right, above = min(col + 1, view.width - 1), min(row + 1, view.height - 1)
    return corner, _cell_at(view, row, right), _cell_at(view, above, col), _cell_at(view, above, right)
