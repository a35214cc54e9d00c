"""Lines: points along polylines, and the cells of grids that lines cross, for kernels and for Python.

There are two walks over cells. `Walk` visits every cell that a line crosses: what a beam or a wall touches.
`cell_along` takes one cell per step in a direction, and passes between two cells that touch at a corner: what can be
seen, twice as fast.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit


class Walk(NamedTuple):
    """A position on a walk over the cells that a line crosses.

    Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing" (1987).

    Start it by `start_walk`, go on by `next_cell` while `rows_left + cols_left > 0`.
    """

    row: int
    col: int
    rows_left: int
    """Borders between rows that the line still crosses; those between columns likewise."""
    cols_left: int
    next_row: float
    """Share of the line after which it crosses the next border between rows; inf after the last one."""
    next_col: float
    row_step: int
    """1 where rows rise along the line, -1 otherwise."""
    col_step: int
    per_row: float
    """Share of the line between two borders between rows."""
    per_col: float


@njit(cache=True, error_model="numpy")
def start_walk(x0, y0, x1, y1):
    """Return the walk along the line from (x0, y0) to (x1, y1) [cells], in its first cell; cell c holds [c, c + 1)."""
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
    """Return the walk in the next cell that its line crosses; through a corner, along the row first."""
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
    """Return (row, column) of the cell that lies `num_steps` from the centre of the cell (row, col).

    A step is `d_row` rows and `d_col` columns, both from -1 to 1. Where one of them is 1, no row or column is left out.
    """
    return math.floor(row + 0.5 + num_steps * d_row), math.floor(col + 0.5 + num_steps * d_col)


@njit(cache=True, error_model="numpy")
def longest_step(angle):
    """Return the step along a direction [rad] that moves by one whole row or column, as (rows, columns)."""
    d_row, d_col = math.sin(angle), math.cos(angle)
    scale = max(abs(d_row), abs(d_col))
    return d_row / scale, d_col / scale


def lengths_along(points: np.ndarray) -> np.ndarray:
    """Return the lengths from the start of a polyline, shape (n, 2), n > 0, to its points: shape (n,), float64 [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def points_at(points: np.ndarray, along: np.ndarray, distances: np.ndarray | float) -> np.ndarray:
    """Return points of a polyline at distances along it, shape (...) [m]; its ends beyond: shape (..., 2), float64 [m].

    `points`: shape (n, 2), n > 0 [m]; `along`: what `lengths_along` returns for them.
    """
    return np.stack([np.interp(distances, along, points[:, k]) for k in (0, 1)], axis=-1)


def resample(points: np.ndarray, spacing: float) -> np.ndarray:
    """Put points at equal distances of at most `spacing` [m] on a polyline: shape (m, 2), float64 [m].

    Both ends of `points`, shape (n, 2) [m], are among them; fewer than two are returned as they are.
    """
    if len(points) < 2:
        return points
    along = lengths_along(points)
    num_points = max(2, math.ceil(along[-1] / spacing) + 1)
    return points_at(points, along, np.linspace(0.0, along[-1], num_points))
