"""Drawing scans into the map."""

import math

import numpy as np
from numba import njit

from .area import share_behind_hit, share_cut_off
from .cells import AVERAGE, GAIN_ONE, MAX_COUNT, ONE, integrate, percent

AVG, BASE, REPORT = 0, 1, 2
"""Kinds of cells."""


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


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def _touch(words, occupancy, index, target, gain, width, new_cells, num_new):
    """Integrate one observation into one cell and return the number of cells that became known."""
    word = words[index]
    if word & MAX_COUNT == 0:
        new_cells[num_new, 0] = index // width
        new_cells[num_new, 1] = index % width
        num_new += 1
    word = integrate(word, target, gain)
    words[index] = word
    occupancy[index] = percent(word)
    return num_new


@njit(cache=True, error_model="numpy")
def draw_scan(
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
    """Draw a scan into a map that has room for it.

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
        add_blur: whether the ramp adds to the occupancy of a passed cell, or takes its place.
        new_cells: shape (n, 2), int32, written: row and column of cells that became known.

    Returns:
        Number of cells that became known.
    """
    width = words.shape[1]
    flat = words.ravel()
    flat_occupancy = occupancy.ravel()
    num_new = 0
    row_0, col_0 = math.floor(y), math.floor(x)
    start = row_0 * width + col_0
    free_target, free_gain = _observation(cell, empty_prob, quality, 0.0)
    for k in range(ranges.shape[0]):
        if math.isnan(ends[k, 0]):
            continue
        hit = ranges[k] < range_max
        row_1, col_1 = math.floor(ends[k, 1]), math.floor(ends[k, 0])
        d_row, d_col = row_1 - row_0, col_1 - col_0
        dir_x, dir_y = ends[k, 0] - x, ends[k, 1] - y
        length = max(abs(d_row), abs(d_col))
        if abs(d_col) >= abs(d_row):
            major_step, minor_step = (1 if d_col >= 0 else -1), (width if d_row >= 0 else -width)
            minor = abs(d_row)
        else:
            major_step, minor_step = (width if d_row >= 0 else -width), (1 if d_col >= 0 else -1)
            minor = abs(d_col)
        slope = (minor << 32) // max(length, 1)
        half = (1 << 31) - 1

        end_prob, end_quality = (occupied_prob if hit else empty_prob), quality
        if by_area and hit:
            share = share_behind_hit(row_1, col_1, ends[k, 0], ends[k, 1], dir_x, dir_y)
            end_prob = max(share, empty_prob)
        elif by_area:
            end_quality *= share_cut_off(row_1, col_1, x, y, dir_x, dir_y)

        blurred = hit and hole > 0.0 and hole * hole < d_row * d_row + d_col * d_col
        ramp_start = max(0, length - math.ceil(hole)) if blurred else length
        plain_end = 0 if by_area else ramp_start
        for i in range(plain_end):
            index = start + i * major_step + ((i * slope + half) >> 32) * minor_step
            num_new = _touch(flat, flat_occupancy, index, free_target, free_gain, width, new_cells, num_new)
        for i in range(plain_end, length):
            index = start + i * major_step + ((i * slope + half) >> 32) * minor_step
            row, col = index // width, index % width
            prob, weight, ramp = empty_prob, quality, 0.0
            if by_area:
                weight *= share_cut_off(row, col, x, y, dir_x, dir_y)
            square = (row - row_1) ** 2 + (col - col_1) ** 2
            if blurred and square < hole * hole:
                ramp = (1.0 - square / (hole * hole)) * end_prob
                prob = min(prob + ramp, 1.0) if add_blur else ramp
            target, gain = _observation(cell, prob, weight, ramp)
            num_new = _touch(flat, flat_occupancy, index, target, gain, width, new_cells, num_new)
        target, gain = _observation(cell, end_prob, end_quality, end_prob if hit else 0.0)
        index = row_1 * width + col_1
        num_new = _touch(flat, flat_occupancy, index, target, gain, width, new_cells, num_new)
    return num_new
