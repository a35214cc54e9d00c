"""Integrating a scan into the maps of all particles."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ..map_update import SIDE_START, walk
from ..mapping.log_odds_kernels import MAX_STAMP, STAMP_BITS, LogOddsModel, observe, percent
from ..scans import beam_ends
from .tiles import TILE_BITS, level_start, own_tile

ROW_BITS = 32
"""Row and column of a cell in one number: row * 2^32 + column."""
_COLUMN = (1 << ROW_BITS) - 1


class Scan(NamedTuple):
    """A scan as it is integrated."""

    model: LogOddsModel
    number: int
    """Counted from the reset."""
    stamp: int
    """What the words of observed cells are marked with, from 1 to `MAX_STAMP`, other than all that they hold."""
    num_levels: int


@njit(cache=True, error_model="numpy")
def find_ends(ranges, geometry, skip_exceeding, poses, corner, ends, sensors):
    """Find where the beams of a scan end in the maps of all particles.

    Args:
        ranges: shape (num_beams,), float32 [m], as in `beam_ends`.
        geometry: `ScanGeometry`.
        skip_exceeding: whether beams without a return are ignored.
        poses: shape (num_particles, 3), float64, of the base, map frame [m, m, rad].
        corner: column and row of the first cell, counted from the map frame's origin.
        ends: shape (num_particles, num_beams, 3), float64, written: see `beam_ends`.
        sensors: shape (num_particles, 2), float64, written: position of the lidar from the map's corner [cells].

    Returns:
        Smallest and greatest column and row that the scan touches in any of the maps.
    """
    col_min = row_min = 1 << 40
    col_max = row_max = -(1 << 40)
    for p in range(poses.shape[0]):
        c, s = math.cos(poses[p, 2]), math.sin(poses[p, 2])
        x = (poses[p, 0] + c * geometry.mount_x - s * geometry.mount_y) / geometry.resolution - corner[0]
        y = (poses[p, 1] + s * geometry.mount_x + c * geometry.mount_y) / geometry.resolution - corner[1]
        sensors[p, 0], sensors[p, 1] = x, y
        extent = beam_ends(ranges, geometry, skip_exceeding, x, y, c, s, ends[p])
        col_min, row_min = min(col_min, extent[0]), min(row_min, extent[1])
        col_max, row_max = max(col_max, extent[2]), max(row_max, extent[3])
    return col_min, row_min, col_max, row_max


@njit(cache=True, error_model="numpy")
def integrate_level(pool, index, tiles_wide, ends, sensor, scan, level):
    """Integrate a scan into one level of a map, cell by cell as `integrate_log_odds` does.

    A scan that was broken off may be integrated again: what it has observed it does not observe twice.

    Args:
        pool: `TilePool`, written.
        index: shape (num_tiles,), int32: slots of the map, written.
        tiles_wide: number of tiles in a row of the map.
        ends: shape (num_beams, 3), float64, from `beam_ends`.
        sensor: position of the lidar from the map's corner (x, y) [cells of the finest level].
        scan: `Scan`.
        level: number of the level.

    Returns:
        Whether the pool had room; else the scan was broken off.
    """
    bits, start, cells, scale = TILE_BITS - level, level_start(level), pool.words.shape[1], 0.5**level
    mask = (1 << bits) - 1
    # Handing arrays to a function costs more than what there is to do for a cell, or for a tile that is owned already.
    words, occupancy = pool.words.ravel(), pool.occupancy.ravel()
    references, written = pool.references, pool.written
    hit, passed, bound = scan.model.hit, scan.model.passed, scan.model.bound
    stamp, number = scan.stamp, scan.number
    for k in range(ends.shape[0]):
        if ends[k, 2] > 0.0 and not math.isnan(ends[k, 0]):
            row, col = math.floor(ends[k, 1] * scale), math.floor(ends[k, 0] * scale)
            tile = (row >> bits) * tiles_wide + (col >> bits)
            slot = index[tile]
            if references[slot] != 1 or written[slot] != number:
                slot = own_tile(pool, index, tile, number)
                if slot < 0:
                    return False
            at = np.uint64(slot * cells + start + ((row & mask) << bits) + (col & mask))
            word = words[at]
            if word & MAX_STAMP != stamp:
                word = observe(word, hit, bound, stamp)
                words[at], occupancy[at] = word, percent(word >> STAMP_BITS)
    row_0, col_0 = math.floor(sensor[1] * scale), math.floor(sensor[0] * scale)
    for k in range(ends.shape[0]):
        if math.isnan(ends[k, 0]):
            continue
        row_1, col_1 = math.floor(ends[k, 1] * scale), math.floor(ends[k, 0] * scale)
        length, slope, step, side_step = walk(row_1 - row_0, col_1 - col_0, 1 << ROW_BITS)
        base, side = (row_0 << ROW_BITS) + col_0, SIDE_START
        last_tile, first_cell = -1, 0
        for _ in range(length + 1):
            both = base + (side >> 32) * side_step
            row, col = both >> ROW_BITS, both & _COLUMN
            tile = (row >> bits) * tiles_wide + (col >> bits)
            if tile != last_tile:
                slot = index[tile]
                if references[slot] != 1 or written[slot] != number:
                    slot = own_tile(pool, index, tile, number)
                    if slot < 0:
                        return False
                last_tile, first_cell = tile, slot * cells + start
            at = np.uint64(first_cell + ((row & mask) << bits) + (col & mask))
            word = words[at]
            if word & MAX_STAMP != stamp:
                word = observe(word, passed, bound, stamp)
                words[at], occupancy[at] = word, percent(word >> STAMP_BITS)
            base, side = base + step, side + slope
    return True


@njit(cache=True, error_model="numpy")
def integrate_into_maps(pool, index, tiles_wide, ends, sensors, is_integrated, scan, first):
    """Integrate a scan into maps, from the one of number `first` on.

    Args:
        pool: `TilePool`, written.
        index: shape (num_particles, num_tiles), int32: slots of the maps, written.
        tiles_wide: number of tiles in a row of the maps.
        ends: shape (num_particles, num_beams, 3), float64, from `find_ends`.
        sensors: shape (num_particles, 2), float64, from `find_ends`.
        is_integrated: shape (num_particles,), bool: which maps to integrate it into.
        scan: `Scan`.
        first: number of the first map.

    Returns:
        Number of the map for which the pool had no room any more, and which is to be the first of another call;
        otherwise the number of maps.
    """
    for p in range(first, index.shape[0]):
        if is_integrated[p]:
            for level in range(scan.num_levels):
                if not integrate_level(pool, index[p], tiles_wide, ends[p], sensors[p], scan, level):
                    return p
    return index.shape[0]
