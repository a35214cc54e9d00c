"""Occupancy grid of TinySLAM: a cell stores the mean of its observations, or their exponential average.

A cell is packed into 32 bits: signed fixed-point occupancy in the upper 20 (18 fractional), and number of observations
in the lower 12. Sums of occupancies are exact.
"""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import MapUpdate
from lidarnaut.envs.geometry import OCCUPIED_FROM, Pose2D
from lidarnaut.envs.robots import LidarParams

from .growing_map import GrowingMap, to_rows_and_columns
from .scans import SIDE_START, beam_ends, walk
from .slam_params import TinySlamParams

COUNT_BITS = 12
MAX_COUNT = (1 << COUNT_BITS) - 1
"""Maximum number of observations that a cell counts; each later one has weight 1 / (`MAX_COUNT` + 1) in the mean."""
FULL_OCCUPANCY = 1 << 18
"""Fixed-point integer for occupancy 1 (18 fractional bits)."""
_GAIN_ONE = 1 << 24
_GAINS = np.round(_GAIN_ONE / np.arange(1, MAX_COUNT + 2)).astype(np.int64)


class InverseSensorModel(NamedTuple):
    """Inverse sensor model: occupancies that a beam assigns to cells."""

    occupied_prob: float
    empty_prob: float
    hole: float
    """Length before a beam endpoint over which occupancy rises from free to occupied [cells]."""
    add_blur: bool
    uses_area: bool
    """Weigh cells along a beam by the area that it cuts off; the endpoint's occupancy is the area behind it."""
    is_base: bool
    """Cells store exponential averages instead of means."""


def unvisited_word(value: float) -> int:
    """Pack an unobserved map cell, which scan matching reads as occupancy `value`, from -1 to 1."""
    return round(value * FULL_OCCUPANCY) << COUNT_BITS


@njit(cache=True, error_model="numpy")
def observe(word, target):
    """Return a packed map cell (int32) updated by an observed occupancy, `target`, in units of 2^-18."""
    count, value = word & MAX_COUNT, word >> COUNT_BITS
    value += ((target - value) * _GAINS[np.uint64(count)] + _GAIN_ONE // 2) >> 24
    return (value << COUNT_BITS) | min(count + 1, MAX_COUNT)


@njit(cache=True, error_model="numpy")
def _weighted(prob, quality):
    return round(FULL_OCCUPANCY * (0.5 + (prob - 0.5) * quality))


@njit(cache=True, error_model="numpy")
def smaller_part(offset, c, s):
    """Return the smaller of the two parts of a unit cell cut by a line at `offset` from its centre; 0.5 if none is cut.

    `c`, `s`: cosine and sine of the line's direction. The parts are a triangle and a pentagon, or two trapezoids.
    """
    large, small, offset = max(abs(c), abs(s)), min(abs(c), abs(s)), abs(offset)
    reach = 0.5 * (large + small)
    if offset >= reach:
        return 0.5
    return (reach - offset) ** 2 / (2.0 * large * small) if offset > reach - small else 0.5 - offset / large


@njit(cache=True, error_model="numpy")
def integrate_scan(words, occupancy, ranges, pose, geometry, corner, model, quality, ends, cells):
    """Insert a scan into an occupancy grid; return the numbers of new and of changed cells.

    Cells along a beam are observed as free, and the endpoint of a return as occupied, with a gradual rise before it.
    `words`: packed cells, shape (height, width), int32. `occupancy`: same shape, int8 [percent]. `quality`: weight of
    the scan from 0 to 1. `cells`: two arrays, shape (n, 2), int32, that receive row and column of cells observed for
    the first time, and of cells that became occupied or free, possibly several times. Scan arguments as in `beam_ends`.
    """
    (x, y), _ = beam_ends(ranges, pose, geometry, corner, ends)
    new_cells, changed_cells = cells
    width = words.shape[1]
    flat, flat_occupancy = words.ravel(), occupancy.ravel()
    num_new = num_changed = 0
    row_0, col_0 = math.floor(y), math.floor(x)
    passed, occupied = _weighted(model.empty_prob, quality), _weighted(model.occupied_prob, quality)
    is_plain, settled = not (model.uses_area or model.is_base), passed << COUNT_BITS
    for k in range(ends.shape[0]):
        if math.isnan(ends[k, 0]):
            continue
        row_1, col_1 = math.floor(ends[k, 1]), math.floor(ends[k, 0])
        length, slope, step, side_step = walk(row_1 - row_0, col_1 - col_0, width)
        hole = model.hole if model.hole * model.hole < (row_1 - row_0) ** 2 + (col_1 - col_0) ** 2 else 0.0
        # Earlier cells are free.
        first_special = max(length - math.ceil(hole), 0) if ends[k, 2] > 0.0 else length + 1
        base, side = row_0 * width + col_0, SIDE_START
        c, s, hit_prob = 1.0, 0.0, model.occupied_prob
        if model.uses_area:
            reach = math.hypot(ends[k, 0] - x, ends[k, 1] - y)
            c, s = (ends[k, 0] - x) / reach, (ends[k, 1] - y) / reach
            ahead = c * (col_1 + 0.5 - ends[k, 0]) + s * (row_1 + 0.5 - ends[k, 1])
            part = smaller_part(ahead, s, c)
            hit_prob = 1.0 - part if ahead > 0.0 else part
        for step_number in range(length + 1):
            index = np.uint64(base + (side >> 32) * side_step)
            base, side = base + step, side + slope
            word = flat[index]
            if is_plain and step_number < first_special and 0 < word - settled <= MAX_COUNT:
                flat[index] = min(word + 1, settled + MAX_COUNT)  # the mean of free observations stays
                continue
            target, prob, weight = passed, model.empty_prob, quality
            if step_number >= first_special:
                square = (int(index) // width - row_1) ** 2 + (int(index) % width - col_1) ** 2
                if square == 0:
                    target, prob = occupied, hit_prob
                elif square < hole * hole:
                    ramp = hit_prob * (1.0 - square / (hole * hole))
                    prob = min(model.empty_prob + ramp, 1.0) if model.add_blur else ramp
                    target = _weighted(prob, quality)
            is_new = word & MAX_COUNT == 0
            if model.uses_area:
                row, col = int(index) // width, int(index) % width
                if not (row == row_1 and col == col_1 and ends[k, 2] > 0.0):
                    weight *= smaller_part(c * (row + 0.5 - y) - s * (col + 0.5 - x), c, s)
                target = _weighted(prob, weight)
            if model.is_base:
                value = word >> COUNT_BITS if word & MAX_COUNT else FULL_OCCUPANCY // 2
                value += round(weight * (prob * FULL_OCCUPANCY - value))
                word = (value << COUNT_BITS) | min((word & MAX_COUNT) + 1, MAX_COUNT)
            else:
                word = observe(word, target)
            percent = ((word >> COUNT_BITS) * 100 + FULL_OCCUPANCY // 2) >> 18
            if is_new:
                new_cells[num_new, 0] = index
                num_new += 1
            elif (percent >= OCCUPIED_FROM) != (flat_occupancy[index] >= OCCUPIED_FROM):
                changed_cells[num_changed, 0] = index
                num_changed += 1
            flat[index], flat_occupancy[index] = word, percent
    to_rows_and_columns(new_cells[:num_new], width)
    to_rows_and_columns(changed_cells[:num_changed], width)
    return num_new, num_changed


class GridMap(GrowingMap):
    """Occupancy grid whose cells store averages of observed occupancies."""

    def __init__(self, params: TinySlamParams, lidar: LidarParams) -> None:
        super().__init__(params, lidar)
        hole = params.hole_width / params.resolution
        kinds = params.blur == "add", params.occupancy_estimator == "area", params.cell_type == "base"
        self.model = InverseSensorModel(params.occupied_prob, params.empty_prob, hole, *kinds)
        self.unvisited = unvisited_word(params.unvisited)
        self.words = np.full(self.grid.data.shape, self.unvisited, dtype=np.int32)

    def integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        """Insert a scan, shape (num_beams,), float32 [m], at a base pose, map frame.

        `quality`: weight of the scan from 0 to 1.
        """
        window, how = self._make_room(ranges[None], np.array([pose])), (self.model, float(quality))
        scan = (ranges, tuple(pose), self.geometry, self.corner)
        counts = integrate_scan(self.words, self.grid.data, *scan, *how, self._ends, self._cells)
        return self._updated(window, counts)

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        super()._pad(margins)
        self.words = np.pad(self.words, margins, constant_values=self.unvisited)
