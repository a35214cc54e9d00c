"""Integrating scans into the map."""

import math

import numpy as np
from numba import njit

from .area import share_behind_hit, share_cut_off
from .cells import AVERAGE, GAIN_ONE, MAX_COUNT, ONE, integrate, percent

AVG, BASE, REPORT = 0, 1, 2
"""Kinds of cells."""
SIDE_START = (1 << 31) - 1
"""Half a cell, less a grain, with 32 fractional bits: a line right between two cells takes the nearer to its start."""


@njit(cache=True, error_model="numpy")
def beam_ends(ranges, directions, range_max, skip_exceeding, x, y, c, s, resolution, ends):
    """Find where the beams of a scan end in the map.

    Args:
        ranges: shape (num_beams,), float32 [m]; no return from `range_max` on, NaN for a beam to ignore.
        directions: shape (2, num_beams), float64, cosine and sine of the beams in the base frame.
        range_max: how far a beam without a return clears [m].
        skip_exceeding: whether beams without a return are ignored.
        x: position of the lidar [cells].
        y: position of the lidar [cells].
        c: cosine of the base's heading.
        s: sine of the base's heading.
        resolution: side of a cell [m].
        ends: shape (num_beams, 2), float64, written: x, y [cells], NaN for beams to ignore.

    Returns:
        Smallest and greatest column and row that the scan touches: col_min, row_min, col_max, row_max.
    """
    x_min = x_max = x
    y_min = y_max = y
    for k in range(ranges.shape[0]):
        r = float(ranges[k])
        if not r > 0.0 or (r >= range_max and skip_exceeding):
            ends[k, 0] = np.nan
            continue
        r = min(r, range_max) / resolution
        end_x = x + r * (c * directions[0, k] - s * directions[1, k])
        end_y = y + r * (s * directions[0, k] + c * directions[1, k])
        ends[k, 0], ends[k, 1] = end_x, end_y
        x_min, x_max = min(x_min, end_x), max(x_max, end_x)
        y_min, y_max = min(y_min, end_y), max(y_max, end_y)
    return math.floor(x_min), math.floor(y_min), math.floor(x_max), math.floor(y_max)


@njit(cache=True, error_model="numpy")
def _observation(cell, prob, quality, ramp):
    """Return target and gain by which a cell takes in an observation, fixed-point.

    Args:
        cell: AVG, BASE or REPORT.
        prob: occupancy observed.
        quality: weight of the observation, from 0 to 1.
        ramp: occupancy that is owed to a hit; 0 for a cell that the beam just passed.
    """
    if cell == AVG:
        return round(ONE * (0.5 + (prob - 0.5) * quality)), AVERAGE
    if cell == BASE:
        return round(ONE * prob), round(GAIN_ONE * quality)
    if ramp > 0.0:
        return ONE, round(GAIN_ONE * ramp)
    return 0, round(GAIN_ONE * prob)


@njit(cache=True, error_model="numpy")
def _walk(d_row, d_col, width):
    """Return how to walk a straight line of cells through a flattened map.

    Args:
        d_row: rows from the first cell to the last.
        d_col: columns from the first cell to the last.
        width: cells in a row of the map.

    Returns:
        Number of steps; what each adds to the sideways position, with 32 fractional bits; what a step forward and what
        one sideways add to the index.
    """
    row_step, col_step = (width if d_row > 0 else -width), (1 if d_col > 0 else -1)
    d_row, d_col = abs(d_row), abs(d_col)
    if d_col >= d_row:
        return d_col, (d_row << 32) // max(d_col, 1), col_step, row_step
    return d_row, (d_col << 32) // d_row, row_step, col_step


@njit(cache=True, error_model="numpy")
def _near_end(row, col, end_row, end_col, x, y, end_x, end_y, hit, by_area, occupied_prob, empty_prob, hole, add_blur):
    """Return what a beam reports of a cell that it does more to than just pass.

    Args:
        row: row of the cell.
        col: column of the cell.
        end_row: row of the beam's last cell.
        end_col: column of the beam's last cell.
        x: where the beam starts [cells].
        y: where the beam starts [cells].
        end_x: where the beam ends [cells].
        end_y: where the beam ends [cells].
        hit: whether the beam ends in a hit.
        by_area: whether the area estimator is used.
        occupied_prob: occupancy reported of the cell of a hit.
        empty_prob: occupancy reported of cells that a beam passes.
        hole: length of the ramp [cells]; 0 for none.
        add_blur: whether the ramp adds to the occupancy of a passed cell, or replaces it.

    Returns:
        Occupancy reported; its weight; the part of it that is owed to the hit.
    """
    dir_x, dir_y = end_x - x, end_y - y
    hit_prob = occupied_prob
    if by_area and hit:
        hit_prob = max(share_behind_hit(end_row, end_col, end_x, end_y, dir_x, dir_y), empty_prob)
    square = (row - end_row) ** 2 + (col - end_col) ** 2
    if hit and square == 0:
        return hit_prob, 1.0, hit_prob
    weight = share_cut_off(row, col, x, y, dir_x, dir_y) if by_area else 1.0
    if not hit or square >= hole * hole:
        return empty_prob, weight, 0.0
    ramp = hit_prob * (1.0 - square / (hole * hole))
    return (min(empty_prob + ramp, 1.0) if add_blur else ramp), weight, ramp


@njit(cache=True, error_model="numpy")
def integrate_scan(
    words,
    occupancy,
    ranges,
    range_max,
    ends,
    x,
    y,
    cell,
    by_area,
    occupied_prob,
    empty_prob,
    quality,
    hole,
    add_blur,
    new_cells,
):
    """Integrate a scan into a map that has room for it.

    Each beam is walked from the lidar's cell to its end, one cell per column or row, whichever it crosses more of. A
    hit occupies the last cell, and the ramp of the wall blur leads up to it, unless the beam is shorter than the ramp.

    Args:
        words: shape (height, width), int32, the map, written.
        occupancy: shape (height, width), int8, the same in percent, written.
        ranges: shape (num_beams,), float32 [m]; hits are those below `range_max`.
        range_max: the lidar's range [m].
        ends: shape (num_beams, 2), float64, where beams end (x, y) [cells], NaN for beams to ignore.
        x: position of the lidar from the map's corner [cells].
        y: position of the lidar from the map's corner [cells].
        cell: AVG, BASE or REPORT.
        by_area: whether the area estimator is used.
        occupied_prob: occupancy reported of the cell of a hit.
        empty_prob: occupancy reported of cells that a beam passes.
        quality: weight of the scan.
        hole: length of the ramp [cells].
        add_blur: whether the ramp adds to the occupancy of a passed cell, or replaces it.
        new_cells: shape (n, 2), int32, written: row and column of cells that became known.

    Returns:
        Number of cells that became known.
    """
    width = words.shape[1]
    flat, flat_occupancy = words.ravel(), occupancy.ravel()
    num_new = 0
    row_0, col_0 = math.floor(y), math.floor(x)
    free_target, free_gain = _observation(cell, empty_prob, quality, 0.0)
    for k in range(ranges.shape[0]):
        end_x, end_y = ends[k, 0], ends[k, 1]
        if math.isnan(end_x):
            continue
        row_1, col_1 = math.floor(end_y), math.floor(end_x)
        length, slope, step, side_step = _walk(row_1 - row_0, col_1 - col_0, width)
        hit = ranges[k] < range_max
        ramp = hole if hole * hole < (row_1 - row_0) ** 2 + (col_1 - col_0) ** 2 else 0.0
        # Cells before this one are just passed, and all say the same.
        first_special = 0 if by_area else max(length - math.ceil(ramp), 0) if hit else length + 1
        base, side = row_0 * width + col_0, SIDE_START
        for _ in range(first_special):
            index = np.uint64(base + (side >> 32) * side_step)
            word = flat[index]
            if word & MAX_COUNT == 0:
                new_cells[num_new, 0] = index
                num_new += 1
            word = integrate(word, free_target, free_gain)
            flat[index] = word
            flat_occupancy[index] = percent(word)
            base, side = base + step, side + slope
        for _ in range(first_special, length + 1):
            index = np.uint64(base + (side >> 32) * side_step)
            row, col = int(index) // width, int(index) % width
            prob, weight, strength = _near_end(
                row, col, row_1, col_1, x, y, end_x, end_y, hit, by_area, occupied_prob, empty_prob, ramp, add_blur
            )
            target, gain = _observation(cell, prob, quality * weight, strength)
            word = flat[index]
            if word & MAX_COUNT == 0:
                new_cells[num_new, 0] = index
                num_new += 1
            word = integrate(word, target, gain)
            flat[index] = word
            flat_occupancy[index] = percent(word)
            base, side = base + step, side + slope
    for k in range(num_new):
        index = new_cells[k, 0]
        new_cells[k, 0], new_cells[k, 1] = index // width, index % width
    return num_new
