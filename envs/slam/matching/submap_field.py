"""Occupancy fields of submaps, rendered from the scans that a submap consists of.

Only the scans are stored for good; the field of a submap is made when a scan is to be matched with it.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

LOG_ODDS_ONE = 100
"""Log-odds of 1 as an integer: sums of integers do not depend on their order."""
STAMP_BITS = 12
"""Bits of a cell's word that hold the number of the scan that changed it last."""
MAX_SCANS = (1 << STAMP_BITS) - 1
"""Most scans that a field is rendered from."""
UNKNOWN_PERCENT = 50
"""Value of field cells that no beam crossed; above it cells are occupied, below it free."""

_STAMP = MAX_SCANS
_SIDE_START = (1 << 31) - 1  # half a cell, less a grain: a line right between two cells takes the nearer to its start


class Scans(NamedTuple):
    """Scans in the frame of a submap."""

    points: np.ndarray
    """Shape (n, 2), float32: hits in the base frame, of these scans and perhaps of others [m]."""
    spans: np.ndarray
    """Shape (num_scans, 2), int64: first row of `points` of each scan, and the one after its last."""
    poses: np.ndarray
    """Shape (num_scans, 3), float64: poses of the base in the submap's frame [m, m, rad]."""
    mount_x: float
    """Position of the lidar in the base frame, with `mount_y` [m]."""
    mount_y: float


class FieldGeometry(NamedTuple):
    """How the cells of a field lie in the submap's frame."""

    x: float
    """Position of the corner of cell (0, 0), with `y` [m]."""
    y: float
    resolution: float
    """Side of a cell [m]."""


class SensorModel(NamedTuple):
    """What one scan adds to the log-odds of a cell, as integers; see `LOG_ODDS_ONE`."""

    hit: int = 220
    """For a hit in the cell; the probability is 0.9."""
    passed: int = -41
    """For beams that pass it; the probability is 0.4."""
    limit: int = 1200
    """Largest absolute value of a cell."""


@njit(cache=True, error_model="numpy")
def scan_extent(scans):
    """Return the least and greatest x and y of hits and lidars: x_min, y_min, x_max, y_max, submap frame [m]."""
    x_min = y_min = np.inf
    x_max = y_max = -np.inf
    for i in range(scans.poses.shape[0]):
        c, s = math.cos(scans.poses[i, 2]), math.sin(scans.poses[i, 2])
        for k in range(scans.spans[i, 0] - 1, scans.spans[i, 1]):
            u, v = scans.mount_x, scans.mount_y
            if k >= scans.spans[i, 0]:
                u, v = float(scans.points[k, 0]), float(scans.points[k, 1])
            x, y = scans.poses[i, 0] + c * u - s * v, scans.poses[i, 1] + s * u + c * v
            x_min, x_max = min(x_min, x), max(x_max, x)
            y_min, y_max = min(y_min, y), max(y_max, y)
    return x_min, y_min, x_max, y_max


@njit(cache=True, error_model="numpy")
def _pass_beam(flat, start, rows, cols, width, number, model):
    """Walk from cell `start` over so many rows and columns, and integrate the cells before the last one as free."""
    row_step, col_step = (width if rows > 0 else -width), (1 if cols > 0 else -1)
    length, side_length, step, side_step = abs(cols), abs(rows), col_step, row_step
    if abs(rows) > abs(cols):
        length, side_length, step, side_step = abs(rows), abs(cols), row_step, col_step
    slope, side, base = (side_length << 32) // max(length, 1), _SIDE_START, start
    for _ in range(length):
        index = np.uint64(base + (side >> 32) * side_step)
        word = flat[index]
        if word & _STAMP != number:
            flat[index] = (max((word >> STAMP_BITS) + model.passed, -model.limit) << STAMP_BITS) | number
        base, side = base + step, side + slope


@njit(cache=True, error_model="numpy")
def integrate_scan(words, scans, i, number, geometry, model):
    """Integrate a scan into a field that has room for it; a cell with a hit is not passed, and each cell changes once.

    Args:
        words: shape (height, width), int32, written: log-odds, and in the lower bits the last scan that changed them.
        scans: `Scans`.
        i: index of the scan.
        number: of the scan in this field, from 1 to `MAX_SCANS`.
        geometry: `FieldGeometry`.
        model: `SensorModel`.
    """
    width, flat = words.shape[1], words.ravel()
    c, s = math.cos(scans.poses[i, 2]), math.sin(scans.poses[i, 2])
    x = (scans.poses[i, 0] - geometry.x) / geometry.resolution
    y = (scans.poses[i, 1] - geometry.y) / geometry.resolution
    c, s = c / geometry.resolution, s / geometry.resolution
    start_col = math.floor(x + c * scans.mount_x - s * scans.mount_y)
    start_row = math.floor(y + s * scans.mount_x + c * scans.mount_y)
    first, last = scans.spans[i, 0], scans.spans[i, 1]
    ends = np.empty((last - first, 2), dtype=np.int64)
    for k in range(last - first):
        u, v = float(scans.points[first + k, 0]), float(scans.points[first + k, 1])
        ends[k, 0], ends[k, 1] = math.floor(y + s * u + c * v), math.floor(x + c * u - s * v)
        index = ends[k, 0] * width + ends[k, 1]
        word = flat[index]
        if word & _STAMP != number:
            flat[index] = (min((word >> STAMP_BITS) + model.hit, model.limit) << STAMP_BITS) | number
    for k in range(last - first):
        _pass_beam(
            flat, start_row * width + start_col, ends[k, 0] - start_row, ends[k, 1] - start_col, width, number, model
        )


@njit(cache=True, error_model="numpy")
def percent_table(model):
    """Return the probability of log-odds from -limit to limit in percent: shape (2 * limit + 1,), uint8."""
    table = np.empty(2 * model.limit + 1, dtype=np.uint8)
    for k in range(table.shape[0]):
        table[k] = round(100.0 / (1.0 + math.exp((model.limit - k) / LOG_ODDS_ONE)))
    return table


@njit(cache=True, error_model="numpy")
def write_percent(words, field, window, table):
    """Write the cells of a window to `field`, shape of `words`, uint8 [percent].

    The window is first column, first row, last column, last row; the table is from `percent_table`.
    """
    limit = table.shape[0] // 2
    for row in range(window[1], window[3] + 1):
        for col in range(window[0], window[2] + 1):
            field[row, col] = table[(words[row, col] >> STAMP_BITS) + limit]


@njit(cache=True, error_model="numpy")
def render_field(scans, resolution, model):
    """Render the occupancy field of a submap.

    Args:
        scans: `Scans`; at most `MAX_SCANS`.
        resolution: side of a cell [m].
        model: `SensorModel`.

    Returns:
        Shape (height, width), uint8, probability of being occupied in percent, `UNKNOWN_PERCENT` where no beam went;
        and its `FieldGeometry`, whose cells are aligned with the submap's frame.

    Raises:
        ValueError: there are too many scans.
    """
    if scans.poses.shape[0] > MAX_SCANS:
        raise ValueError("a field is rendered from at most 4095 scans")
    if scans.poses.shape[0] == 0:
        return np.full((1, 1), UNKNOWN_PERCENT, dtype=np.uint8), FieldGeometry(0.0, 0.0, resolution)
    x_min, y_min, x_max, y_max = scan_extent(scans)
    # One cell more on each side: points within rounding of a border may fall on either side of it.
    col, row = math.floor(x_min / resolution) - 1, math.floor(y_min / resolution) - 1
    width, height = math.floor(x_max / resolution) + 2 - col, math.floor(y_max / resolution) + 2 - row
    geometry = FieldGeometry(col * resolution, row * resolution, resolution)
    words = np.zeros((height, width), dtype=np.int32)
    for i in range(scans.poses.shape[0]):
        integrate_scan(words, scans, i, i + 1, geometry, model)
    field = np.empty((height, width), dtype=np.uint8)
    write_percent(words, field, (0, 0, width - 1, height - 1), percent_table(model))
    return field, geometry
