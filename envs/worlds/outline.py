"""Outlines of solid cells as long straight segments."""

import numpy as np


def outline(solid: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Return the borders between solid and open cells, straight neighbours merged.

    Args:
        solid: shape (height, width), bool; beyond the array counts as solid, so that no segments run along its edge
            unless open cells touch it.
        xs: shape (width + 1,), positions of the grid lines along x [m].
        ys: shape (height + 1,), positions of the grid lines along y [m].

    Returns:
        Shape (n, 4), float64, axis-aligned (x0, y0, x1, y1) [m].
    """
    padded = np.pad(solid, 1, constant_values=True)
    # Border k of a row of cells lies between cell k - 1 and cell k.
    upright = _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T)
    level = _runs(padded[1:, 1:-1] != padded[:-1, 1:-1])
    return np.vstack(
        [
            np.column_stack([xs[upright[:, 0]], ys[upright[:, 1]], xs[upright[:, 0]], ys[upright[:, 2]]]),
            np.column_stack([xs[level[:, 1]], ys[level[:, 0]], xs[level[:, 2]], ys[level[:, 0]]]),
        ]
    ).astype(np.float64)


def _runs(marks: np.ndarray) -> np.ndarray:
    """Return the runs of true values along the rows: shape (n, 3), int64, (row, start, end)."""
    steps = np.diff(np.pad(marks.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(steps == 1)
    ends = np.nonzero(steps == -1)[1]
    return np.column_stack([rows, starts, ends])
