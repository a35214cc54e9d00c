import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarnaut.envs.geometry import NO_WINDOW, Window

SHAPE = 9, 12


def cells(window):
    return {(row, col) for row in range(SHAPE[0]) for col in range(SHAPE[1]) if contains(window, row, col)}


def contains(window, row, col):
    return window.row <= row < window.row + window.height and window.col <= col < window.col + window.width


windows = st.builds(Window, st.integers(0, 8), st.integers(0, 11), st.integers(0, 12), st.integers(0, 12))


@given(windows)
def test_slices_select_the_cells(window):
    data = np.zeros(SHAPE, dtype=bool)
    data[window.slices] = True
    assert set(zip(*np.nonzero(data), strict=True)) == cells(window)


@given(windows, windows)
def test_the_union_is_the_smallest_window_that_contains_both(one, other):
    both = one.union(other)
    corners = [(w.row, w.col, w.row + w.height, w.col + w.width) for w in (one, other) if not w.is_empty]
    if corners:
        low, high = np.min(corners, axis=0)[:2], np.max(corners, axis=0)[2:]
        assert both == (*low, *(high - low))
    assert NO_WINDOW.union(one) == one.union(NO_WINDOW) or one.is_empty


@given(windows, st.integers(0, 4))
def test_a_dilated_window_adds_a_border_and_ends_at_the_grid(window, border):
    near = {
        (row + i, col + j)
        for row, col in cells(window)
        for i in range(-border, border + 1)
        for j in range(-border, border + 1)
    }
    if window.row < SHAPE[0] and window.col < SHAPE[1]:
        assert cells(window.dilated(border, SHAPE)) == {cell for cell in near if contains(Window(0, 0, *SHAPE), *cell)}


@given(windows, st.integers(1, 5))
def test_blocks_are_those_that_overlap_the_window(window, size):
    if not window.is_empty:
        blocks = window.blocks(size)
        rows = {row // size for row in range(window.row, window.row + window.height)}
        cols = {col // size for col in range(window.col, window.col + window.width)}
        assert blocks == Window.spanning((min(rows), min(cols)), (max(rows), max(cols)))


@pytest.mark.parametrize(("rows", "cols"), [(0, 0), (3, -2)])
def test_a_shifted_window_has_the_same_size(rows, cols):
    assert Window(2, 3, 4, 5).shifted(rows, cols) == Window(2 + rows, 3 + cols, 4, 5)
