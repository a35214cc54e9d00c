import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import lines
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.lines import resample

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]])


def crossed(x0, y0, x1, y1):
    walk = lines.start_walk(x0, y0, x1, y1)
    cells = [(walk.row, walk.col)]
    while walk.rows_left + walk.cols_left > 0:
        walk = lines.next_cell(walk)
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
    assert [lines.cell_along(2, 3, 1.0, 0.0, k) for k in range(3)] == [(2, 3), (3, 3), (4, 3)]
    assert [lines.cell_along(0, 0, 0.5, -1.0, k) for k in (1, 2, 3)] == [(1, -1), (1, -2), (2, -3)]


def test_the_longest_step_leaves_out_no_row_or_column():
    for angle in np.linspace(-4.0, 4.0, 57):
        d_row, d_col = lines.longest_step(angle)
        assert max(abs(d_row), abs(d_col)) == 1.0
        assert math.atan2(d_row, d_col) == pytest.approx(math.atan2(math.sin(angle), math.cos(angle)))


def test_lengths_and_points_along():
    along = lines.lengths_along(CORNERS)
    assert along.tolist() == [0.0, 1.0, 1.5]
    assert lines.lengths_along(CORNERS[:1]).tolist() == [0.0]
    assert lines.points_at(CORNERS, along, 1.25).tolist() == [1.0, 0.25]
    assert lines.points_at(CORNERS, along, np.array([-1.0, 0.5, 9.0])).tolist() == [[0.0, 0.0], [0.5, 0.0], [1.0, 0.5]]


def test_resampled_points_are_equally_far_apart_and_keep_the_ends():
    points = resample(CORNERS, 0.1)
    np.testing.assert_allclose(np.hypot(*np.diff(points, axis=0).T), 0.1)
    np.testing.assert_allclose(points[10], (1.0, 0.0), atol=1e-12)
    assert (points[[0, -1]] == CORNERS[[0, -1]]).all()
    assert np.hypot(*np.diff(resample(CORNERS, 0.07), axis=0).T).max() <= 0.07 + 1e-12
    assert len(resample(CORNERS, 10.0)) == 2
    assert len(resample(CORNERS[:1], 0.1)) == 1


@pytest.mark.parametrize(
    ("point", "expected"),
    [((0, 2), 1), ((1, 0), 1), ((0, 0), math.sqrt(2)), ((-3, 0), 0.5), ((-2, 0.1), -0.4), ((1, 2), 0)],
)
def test_clearance_is_the_distance_to_the_nearest_segment_or_circle(point, expected):
    segments, circles = np.array([[1.0, 1.0, 1.0, 3.0]]), np.array([[-2.0, 0.0, 0.5]])
    assert clearance(*point, segments, circles) == pytest.approx(expected)
    assert clearance(0.0, 0.0, np.empty((0, 4)), np.empty((0, 3))) == math.inf
