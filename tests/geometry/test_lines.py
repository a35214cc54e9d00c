import math

import numpy as np
import pytest

from envs.geometry.lines import cell_along, longest_step, next_cell, start_walk


def crossed(x0, y0, x1, y1):
    walk = start_walk(x0, y0, x1, y1)
    cells = [(walk.row, walk.col)]
    while walk.rows_left + walk.cols_left > 0:
        walk = next_cell(walk)
        cells.append((walk.row, walk.col))
    return cells


@pytest.mark.parametrize(
    ("line", "cells"),
    [
        ((0.5, 0.5, 2.5, 0.5), [(0, 0), (0, 1), (0, 2)]),
        ((0.5, 2.5, 0.5, 0.5), [(2, 0), (1, 0), (0, 0)]),
        ((0.5, 0.2, 1.5, 1.2), [(0, 0), (0, 1), (1, 1)]),
        ((1.5, 0.5, 0.5, 1.5), [(0, 1), (0, 0), (1, 0)]),  # through a corner: along the row first
        ((-0.5, -0.2, 0.5, -0.2), [(-1, -1), (-1, 0)]),
        ((0.5, 0.5, 0.5, 0.5), [(0, 0)]),
    ],
)
def test_a_walk_visits_the_cells_in_their_order(line, cells):
    assert crossed(*line) == cells


def test_a_walk_visits_what_dense_samples_of_its_line_fall_into():
    rng = np.random.default_rng(0)
    for _ in range(200):
        start, end = rng.uniform(-8.0, 8.0, (2, 2))
        cells = crossed(*start, *end)
        samples = np.floor(np.linspace(start, end, 2000)[:, ::-1]).astype(int)
        assert set(map(tuple, samples.tolist())) <= set(cells)
        assert cells[-1] == (math.floor(end[1]), math.floor(end[0]))
        assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()


def test_cells_along_a_direction_follow_each_other():
    assert [cell_along(2, 3, 1.0, 0.0, k) for k in range(3)] == [(2, 3), (3, 3), (4, 3)]
    assert [cell_along(0, 0, 0.5, -1.0, k) for k in (1, 2, 3)] == [(1, -1), (1, -2), (2, -3)]


def test_the_longest_step_leaves_out_no_row_or_column():
    for angle in np.linspace(-4.0, 4.0, 57):
        d_row, d_col = longest_step(angle)
        assert max(abs(d_row), abs(d_col)) == 1.0
        assert math.atan2(d_row, d_col) == pytest.approx(math.atan2(math.sin(angle), math.cos(angle)))
