"""Points along polylines, and traversal of grid cells along a line."""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit


class Walk(NamedTuple):
    """State of a traversal of all grid cells that a line crosses (Amanatides and Woo, 1987).

    Start with `start_walk`, then call `next_cell` while `rows_left + cols_left > 0`.
    """

    row: int
    col: int
    rows_left: int
    cols_left: int
    next_row: float
    """Fraction of the line's length before the line enters the next row; inf after the last row."""
    next_col: float
    row_step: int
    col_step: int
    per_row: float
    per_col: float


@njit(cache=True, error_model="numpy")
def start_walk(x0, y0, x1, y1):
    """Start a traversal of the grid cells on the line from (x0, y0) to (x1, y1) [cells], and return its state."""
    row, col = math.floor(y0), math.floor(x0)
    rows_left, cols_left = abs(math.floor(y1) - row), abs(math.floor(x1) - col)
    row_step, col_step = (1 if y1 > y0 else -1), (1 if x1 > x0 else -1)
    per_row = 1.0 / abs(y1 - y0) if y1 != y0 else np.inf
    per_col = 1.0 / abs(x1 - x0) if x1 != x0 else np.inf
    next_row = (row + 1 - y0 if row_step > 0 else y0 - row) * per_row if rows_left > 0 else np.inf
    next_col = (col + 1 - x0 if col_step > 0 else x0 - col) * per_col if cols_left > 0 else np.inf
    return Walk(row, col, rows_left, cols_left, next_row, next_col, row_step, col_step, per_row, per_col)


@njit(cache=True, error_model="numpy")
def next_cell(walk):
    """Advance a grid traversal to the next cell on the line. At a corner of cells, the column changes first."""
    row, col, rows_left, cols_left, next_row, next_col, row_step, col_step, per_row, per_col = walk
    if next_col <= next_row:
        col, cols_left = col + col_step, cols_left - 1
        next_col = next_col + per_col if cols_left > 0 else np.inf
    else:
        row, rows_left = row + row_step, rows_left - 1
        next_row = next_row + per_row if rows_left > 0 else np.inf
    return Walk(row, col, rows_left, cols_left, next_row, next_col, row_step, col_step, per_row, per_col)


@njit(cache=True, error_model="numpy")
def cell_along(row, col, d_row, d_col, num_steps):
    """Return the cell (row, column) that is `num_steps` steps from the centre of cell (`row`, `col`).

    `d_row`, `d_col`: rows and columns per step, each in [-1, 1].
    """
    return math.floor(row + 0.5 + num_steps * d_row), math.floor(col + 0.5 + num_steps * d_col)


@njit(cache=True, error_model="numpy")
def longest_step(angle):
    """Return a step (rows, columns) in the direction `angle` [rad], scaled so that the larger component is one cell."""
    d_row, d_col = math.sin(angle), math.cos(angle)
    scale = max(abs(d_row), abs(d_col))
    return d_row / scale, d_col / scale


def lengths_along(points: np.ndarray) -> np.ndarray:
    """Return the arc length from the start of a polyline to each point, shape (n,), float64 [m].

    `points`: shape (n, 2), n > 0 [m].
    """
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def points_at(points: np.ndarray, along: np.ndarray, distances: np.ndarray | float) -> np.ndarray:
    """Return the points (x, y) of a polyline at given arc lengths, shape (..., 2), float64 [m].

    Args:
        points: shape (n, 2), n > 0 [m].
        along: arc length of each point [m].
        distances: arc lengths to interpolate at, shape (...), clamped to the ends [m].
    """
    return np.stack([np.interp(distances, along, points[:, k]) for k in (0, 1)], axis=-1)


def resample(points: np.ndarray, spacing: float) -> np.ndarray:
    """Resample a polyline, shape (n, 2) [m], at equal distances of at most `spacing` [m]."""
    if len(points) < 2:
        return points
    along = lengths_along(points)
    num_points = max(2, math.ceil(along[-1] / spacing) + 1)
    return points_at(points, along, np.linspace(0.0, along[-1], num_points))
