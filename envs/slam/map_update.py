"""Integrating scans into the map."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from .area import share_behind_hit, share_cut_off
from .cells import AVERAGE, GAIN_ONE, MAX_COUNT, ONE, integrate, percent

AVG, BASE, REPORT = 0, 1, 2
"""Kinds of cells."""
SIDE_START = (1 << 31) - 1
"""Half a cell, less a grain, with 32 fractional bits: a line right between two cells takes the nearer to its start."""


class InverseSensorModel(NamedTuple):
    """What beams say of the cells that they cross; see `TinySlamParams`."""

    cell: int
    """How cells take in observations: AVG, BASE or REPORT."""
    by_area: bool
    """Whether the area estimator is used."""
    occupied_prob: float
    empty_prob: float
    hole: float
    """Length of the ramp in front of a hit [cells]; 0 for none."""
    add_blur: bool
    """Whether the ramp adds to the occupancy of a passed cell, or replaces it."""


class _Beam(NamedTuple):
    """A beam from where it starts to where it ends [cells]."""

    x: float
    y: float
    end_x: float
    end_y: float
    end_row: int
    end_col: int
    hit: bool


@njit(cache=True, error_model="numpy")
def _observation(cell, prob, quality, ramp):
    """Return target and gain, fixed-point, of an observed occupancy; `ramp` is the part of it owed to a hit."""
    if cell == AVG:
        return round(ONE * (0.5 + (prob - 0.5) * quality)), AVERAGE
    if cell == BASE:
        return round(ONE * prob), round(GAIN_ONE * quality)
    if ramp > 0.0:
        return ONE, round(GAIN_ONE * ramp)
    return 0, round(GAIN_ONE * prob)


@njit(cache=True, error_model="numpy")
def walk(d_row, d_col, width):
    """Return how to walk over so many rows and columns, in a straight line through a flattened map.

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
def _near_end(row, col, beam, model, hole):
    """Return the occupancy that a beam reports of a cell, its weight, and the part of it that is owed to the hit."""
    dir_x, dir_y = beam.end_x - beam.x, beam.end_y - beam.y
    hit_prob = model.occupied_prob
    if model.by_area and beam.hit:
        behind = share_behind_hit(beam.end_row, beam.end_col, beam.end_x, beam.end_y, dir_x, dir_y)
        hit_prob = max(behind, model.empty_prob)
    square = (row - beam.end_row) ** 2 + (col - beam.end_col) ** 2
    if beam.hit and square == 0:
        return hit_prob, 1.0, hit_prob
    weight = share_cut_off(row, col, beam.x, beam.y, dir_x, dir_y) if model.by_area else 1.0
    if not beam.hit or square >= hole * hole:
        return model.empty_prob, weight, 0.0
    ramp = hit_prob * (1.0 - square / (hole * hole))
    return (min(model.empty_prob + ramp, 1.0) if model.add_blur else ramp), weight, ramp


@njit(cache=True, error_model="numpy")
def integrate_scan(words, occupancy, ends, x, y, model, quality, new_cells):
    """Integrate a scan into a map that has room for it.

    Each beam is walked from the lidar's cell to its end, one cell per column or row, whichever it crosses more of. A
    hit occupies the last cell, and the ramp of the wall blur leads up to it, unless the beam is shorter than the ramp.

    Args:
        words: shape (height, width), int32, the map, written.
        occupancy: shape (height, width), int8, the same in percent, written.
        ends: shape (num_beams, 3), float64, from `beam_ends`.
        x: position of the lidar from the map's corner [cells].
        y: position of the lidar from the map's corner [cells].
        model: `InverseSensorModel`.
        quality: weight of the scan.
        new_cells: shape (n, 2), int32, written: row and column of cells that became known.

    Returns:
        Number of cells that became known.
    """
    width = words.shape[1]
    flat, flat_occupancy = words.ravel(), occupancy.ravel()
    num_new = 0
    row_0, col_0 = math.floor(y), math.floor(x)
    free_target, free_gain = _observation(model.cell, model.empty_prob, quality, 0.0)
    for k in range(ends.shape[0]):
        end_x, end_y = ends[k, 0], ends[k, 1]
        if math.isnan(end_x):
            continue
        row_1, col_1 = math.floor(end_y), math.floor(end_x)
        beam = _Beam(x, y, end_x, end_y, row_1, col_1, ends[k, 2] > 0.0)
        length, slope, step, side_step = walk(row_1 - row_0, col_1 - col_0, width)
        hole = model.hole if model.hole * model.hole < (row_1 - row_0) ** 2 + (col_1 - col_0) ** 2 else 0.0
        # Cells before this one are just passed, and all say the same.
        first_special = 0 if model.by_area else max(length - math.ceil(hole), 0) if beam.hit else length + 1
        base, side = row_0 * width + col_0, SIDE_START
        for step_number in range(length + 1):
            index = np.uint64(base + (side >> 32) * side_step)
            target, gain = free_target, free_gain
            if step_number >= first_special:
                row, col = int(index) // width, int(index) % width
                prob, weight, strength = _near_end(row, col, beam, model, hole)
                target, gain = _observation(model.cell, prob, quality * weight, strength)
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
