"""Integrating scans into log-odds maps.

A cell is one 32-bit word: its log odds in the upper 16 bits, signed, 9 of them fractional, and in the lower 16 the
number of the scan that last observed it. The number makes sure that each scan observes a cell once, however many beams
cross it; 0 means that none has. Beside it lies the occupancy in percent that follows from the log odds, which is what
the matcher reads.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ..map_update import SIDE_START, walk
from ..scans import beam_ends

STAMP_BITS = 16
"""Bits of a word that hold the number of a scan."""
MAX_STAMP = (1 << STAMP_BITS) - 1
"""Number of the last scan before they start again."""
ONE = 1 << 9
"""Log odds 1 as fixed-point number."""
MAX_LOG_ODDS = 63.0
"""Largest log odds that a cell can be given."""


def _percents() -> np.ndarray:
    """Return occupancies in percent, int8, by log odds; beyond the table they are 0 or 100."""
    log_odds = np.arange(-_HALF, _HALF + 1) / ONE
    return np.round(100.0 / (1.0 + np.exp(-log_odds))).astype(np.int8)


_HALF = 6 * ONE
_PERCENTS = _percents()


class LogOddsModel(NamedTuple):
    """What one scan adds to the log odds of the cells that it observes, fixed-point."""

    hit: int
    """To a cell in which a beam ends."""
    passed: int
    """To a cell that beams only pass, negative."""
    bound: int
    """Largest log odds of a cell, and with the opposite sign the least."""


def log_odds_model(occupied_prob: float, empty_prob: float, max_log_odds: float) -> LogOddsModel:
    """Return the model for the probabilities that a beam reports of the cells that it ends in and passes."""
    hit, passed = (round(ONE * math.log(prob / (1.0 - prob))) for prob in (occupied_prob, empty_prob))
    return LogOddsModel(hit, passed, round(ONE * max_log_odds))


def log_odds(words: np.ndarray) -> np.ndarray:
    """Return the log odds that words stand for, same shape, float64."""
    return (words >> STAMP_BITS) / ONE


@njit(cache=True, error_model="numpy")
def percent(value):
    """Return the occupancy in percent of log odds, fixed-point."""
    return _PERCENTS[np.uint64(min(max(value, -_HALF), _HALF) + _HALF)]


@njit(cache=True, error_model="numpy")
def observe(word, change, bound, stamp):
    """Return the word of a cell after an observation."""
    value = min(max((word >> STAMP_BITS) + change, -bound), bound)
    return (value << STAMP_BITS) | stamp


@njit(cache=True, error_model="numpy")
def integrate_log_odds(words, occupancy, ends, scale, x, y, model, stamp, new_cells):
    """Integrate a scan into a map that has room for it.

    Hits come first; cells that the beams of the same scan pass afterwards are left as the hits made them. (The program
    of Kohlbrecher et al., 2011, undoes instead what beams before have done to a cell that is then hit.)

    Args:
        words: shape (height, width), int32, the map, written.
        occupancy: shape (height, width), int8, the same in percent, written.
        ends: shape (num_beams, 3), float64, from `beam_ends`, in cells of the finest level.
        scale: side of a cell of the finest level in the cells of this one.
        x: position of the lidar from the map's corner [cells of the finest level].
        y: position of the lidar from the map's corner [cells of the finest level].
        model: `LogOddsModel`.
        stamp: number of the scan, from 1 to `MAX_STAMP`, other than all that the words hold.
        new_cells: shape (n, 2), int32, written: row and column of cells that became known.

    Returns:
        Number of cells that became known.
    """
    width = words.shape[1]
    flat, flat_occupancy = words.ravel(), occupancy.ravel()
    num_new = 0
    for k in range(ends.shape[0]):
        if ends[k, 2] > 0.0 and not math.isnan(ends[k, 0]):
            index = np.uint64(math.floor(ends[k, 1] * scale) * width + math.floor(ends[k, 0] * scale))
            word = flat[index]
            if word & MAX_STAMP != stamp:
                if word & MAX_STAMP == 0:
                    new_cells[num_new, 0] = index
                    num_new += 1
                word = observe(word, model.hit, model.bound, stamp)
                flat[index], flat_occupancy[index] = word, percent(word >> STAMP_BITS)
    row_0, col_0 = math.floor(y * scale), math.floor(x * scale)
    last_row, last_col = -1, -1
    for k in range(ends.shape[0]):
        if math.isnan(ends[k, 0]):
            continue
        row_1, col_1 = math.floor(ends[k, 1] * scale), math.floor(ends[k, 0] * scale)
        if row_1 == last_row and col_1 == last_col:
            continue  # passes the cells that the beam before has passed
        last_row, last_col = row_1, col_1
        length, slope, step, side_step = walk(row_1 - row_0, col_1 - col_0, width)
        base, side = row_0 * width + col_0, SIDE_START
        for _ in range(length + 1):
            index = np.uint64(base + (side >> 32) * side_step)
            word = flat[index]
            if word & MAX_STAMP != stamp:
                if word & MAX_STAMP == 0:
                    new_cells[num_new, 0] = index
                    num_new += 1
                word = observe(word, model.passed, model.bound, stamp)
                flat[index], flat_occupancy[index] = word, percent(word >> STAMP_BITS)
            base, side = base + step, side + slope
    for k in range(num_new):
        index = new_cells[k, 0]
        new_cells[k, 0], new_cells[k, 1] = index // width, index % width
    return num_new


@njit(cache=True, error_model="numpy")
def scans_extent(ranges, poses, geometry, skip_exceeding, corner, ends):
    """Return what `beam_ends` does, for scans, shape (n, num_beams), at poses of the base, shape (n, 3), map frame."""
    col_min = row_min = np.int64(1) << 40
    col_max = row_max = -(np.int64(1) << 40)
    for i in range(ranges.shape[0]):
        extent = _find_ends(ranges[i], poses[i], geometry, skip_exceeding, corner, ends)[2]
        col_min, row_min = min(col_min, extent[0]), min(row_min, extent[1])
        col_max, row_max = max(col_max, extent[2]), max(row_max, extent[3])
    return col_min, row_min, col_max, row_max


@njit(cache=True, error_model="numpy")
def integrate_scans(level, ranges, poses, geometry, skip_exceeding, corner, model, stamp, ends, new_cells):
    """Integrate scans into a level of a map that has room for them; what a scan makes known is not told.

    Args:
        level: words and occupancy of the level and its scale, see `integrate_log_odds`.
        ranges: shape (n, num_beams), float32 [m].
        poses: shape (n, 3), float64, of the base, map frame [m, m, rad].
        geometry: `ScanGeometry`.
        skip_exceeding: see `beam_ends`.
        corner: column and row of the finest map's first cell, counted from the map frame's origin.
        model: `LogOddsModel`.
        stamp: number of the first scan; those after it have the next ones.
        ends: shape (num_beams, 3), float64: room to work in.
        new_cells: room to work in, see `integrate_log_odds`.
    """
    words, occupancy, scale = level
    for i in range(ranges.shape[0]):
        x, y, _ = _find_ends(ranges[i], poses[i], geometry, skip_exceeding, corner, ends)
        integrate_log_odds(words, occupancy, ends, scale, x, y, model, stamp + i, new_cells)


@njit(cache=True, error_model="numpy")
def _find_ends(ranges, pose, geometry, skip_exceeding, corner, ends):
    """Write where the beams of a scan end; return the position of the lidar [cells], and what `beam_ends` returns."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = (pose[0] + c * geometry.mount_x - s * geometry.mount_y) / geometry.resolution - corner[0]
    y = (pose[1] + s * geometry.mount_x + c * geometry.mount_y) / geometry.resolution - corner[1]
    return x, y, beam_ends(ranges, geometry, skip_exceeding, x, y, c, s, ends)


@njit(cache=True, error_model="numpy")
def forget_stamps(words):
    """Give all cells that were ever observed the stamp 1, so that the numbers from 2 on are free again."""
    flat = words.ravel()
    for k in range(flat.shape[0]):
        if flat[k] & MAX_STAMP:
            flat[k] = (flat[k] >> STAMP_BITS << STAMP_BITS) | 1
