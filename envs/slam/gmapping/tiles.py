"""Maps that share tiles until one of them is written: copy-on-write.

All tiles of all maps lie in one pool with reference counts. A map is an index: for each tile of the map the slot in the
pool that holds it. To copy a map is to copy its index and to count the references; a tile that several maps refer to is
copied when one of them is to be written.

A tile holds `TILE` x `TILE` cells of the finest level, and the cells of the coarser levels that cover the same square,
one level after the other. A cell is the word of `log_odds_map`, and its occupancy in percent.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from lidarnaut.envs.geometry import UNKNOWN

from ..matching.gauss_newton import at_level, neighbours

TILE_BITS = 5
TILE = 1 << TILE_BITS
"""Cells of the finest level along a side of a tile."""
EMPTY = 0
"""Slot of a tile without any known cell, which all maps share and none writes."""


class TilePool(NamedTuple):
    """Tiles, each in a slot."""

    words: np.ndarray
    """Shape (capacity, cells), int32."""
    occupancy: np.ndarray
    """Shape (capacity, cells), int8: -1 unknown, 0 to 100 [percent]."""
    references: np.ndarray
    """Shape (capacity,), int32: how many maps refer to a slot; `EMPTY` is not counted."""
    written: np.ndarray
    """Shape (capacity,), int64: number of the scan that was last integrated into a slot."""
    free: np.ndarray
    """Shape (capacity,), int32: slots that no map refers to; the first `num_free[0]` of them count."""
    num_free: np.ndarray
    """Shape (1,), int64."""


@njit(cache=True, error_model="numpy")
def level_start(level):
    """Return where the cells of a level begin in a tile."""
    whole = 4 << (2 * TILE_BITS)
    return (whole - (whole >> (2 * level))) // 3


def make_pool(capacity: int, num_levels: int) -> TilePool:
    """Return a pool without tiles but the empty one."""
    cells = level_start(num_levels)
    words, occupancy = np.empty((capacity, cells), dtype=np.int32), np.empty((capacity, cells), dtype=np.int8)
    words[EMPTY], occupancy[EMPTY] = 0, UNKNOWN
    references, written = np.zeros(capacity, dtype=np.int32), np.zeros(capacity, dtype=np.int64)
    free = np.arange(capacity, 0, -1, dtype=np.int32) - 1  # the low ones are taken first
    return TilePool(words, occupancy, references, written, free, np.array([capacity - 1]))


def enlarge_pool(pool: TilePool) -> TilePool:
    """Return a pool of twice the capacity with the same tiles in the same slots."""
    capacity, num_free = len(pool.words), int(pool.num_free[0])
    words, occupancy, references, written = (np.concatenate([each, np.zeros_like(each)]) for each in pool[:4])
    free = np.empty(2 * capacity, dtype=np.int32)
    free[:capacity] = np.arange(2 * capacity - 1, capacity - 1, -1)
    free[capacity : capacity + num_free] = pool.free[:num_free]
    return TilePool(words, occupancy, references, written, free, np.array([capacity + num_free]))


@njit(cache=True, error_model="numpy")
def own_tile(pool, index, tile, number):
    """Return the slot of a tile of a map that is to be written, after copying it if other maps refer to it.

    It is -1, and nothing is changed, if a copy is needed and the pool is full. `index` has shape (num_tiles,), int32:
    slots of the map, written; `number` is that of the scan that will be integrated.
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
    """Replace maps by copies of others, whose numbers are `parents`, shape (num_maps,), int64.

    `index` has shape (num_maps, num_tiles), int32: slots of the maps, written.
    """
    index[:] = index[parents]
    used = pool.references > 0
    pool.references[:] = np.bincount(index.ravel(), minlength=len(used))
    pool.references[EMPTY] = 0
    freed = np.flatnonzero(used & (pool.references == 0))
    pool.free[pool.num_free[0] : pool.num_free[0] + len(freed)] = freed
    pool.num_free[0] += len(freed)


class TileMap(NamedTuple):
    """The map of a particle, to be read."""

    occupancy: np.ndarray
    """Shape (capacity * cells,), int8: the flattened occupancies of the pool."""
    cells: int
    """Cells in a tile, of all levels."""
    slots: np.ndarray
    """Shape (num_tiles,), int32: where the tiles of the map lie in the pool."""
    tiles_wide: int
    """Number of tiles in a row."""


class _TileLevel(NamedTuple):
    """A level of a `TileMap`; see `at_level`."""

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


@overload(at_level, inline="always")
def _at_level_of_tiles(map, level):
    return _level_of_tiles if getattr(map, "instance_class", None) is TileMap else None


@njit(cache=True, error_model="numpy")
def _cell_at(view, row, col):
    """Return where a cell of a `_TileLevel` lies in the flattened occupancies."""
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
    # Clamped at the border: only the first of the four cells is used there.
    right, above = min(col + 1, view.width - 1), min(row + 1, view.height - 1)
    return corner, _cell_at(view, row, right), _cell_at(view, above, col), _cell_at(view, above, right)


@overload(neighbours, inline="always")
def _neighbours_in_tiles(view, row, col):
    return _neighbours_of_tiles if getattr(view, "instance_class", None) is _TileLevel else None


@njit(cache=True, error_model="numpy")
def unpack_level(map, level, out):
    """Write the occupancies of a level to an array of its shape, int8, that is unknown (-1) throughout."""
    bits, start = TILE_BITS - level, level_start(level)
    side = TILE >> level
    for tile in range(map.slots.shape[0]):
        if map.slots[tile] == EMPTY:
            continue
        row, col = tile // map.tiles_wide << bits, tile % map.tiles_wide << bits
        first = map.slots[tile] * map.cells + start
        for i in range(side):
            out[row + i, col : col + side] = map.occupancy[first + i * side : first + (i + 1) * side]
