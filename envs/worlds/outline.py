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
    cols, bottoms, tops = _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T)
    rows, lefts, rights = _runs(padded[1:, 1:-1] != padded[:-1, 1:-1])
    segments = np.empty((len(cols) + len(rows), 4))
    upright, level = segments[: len(cols)], segments[len(cols) :]
    upright[:, 0] = upright[:, 2] = xs[cols]
    upright[:, 1], upright[:, 3] = ys[bottoms], ys[tops]
    level[:, 1] = level[:, 3] = ys[rows]
    level[:, 0], level[:, 2] = xs[lefts], xs[rights]
    return segments


def _runs(marks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the runs of true values along the rows: row, start and end of each, all of shape (n,), int64."""
    steps = np.diff(np.pad(marks.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(steps == 1)
    return rows, starts, np.nonzero(steps == -1)[1]
