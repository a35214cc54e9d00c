"""Occupancy grids with the cell values of ROS."""

from dataclasses import dataclass

import numpy as np

from .window import Window

UNKNOWN = -1
FREE = 0
OCCUPIED = 100
OCCUPIED_FROM = 50
"""Minimum occupancy probability of an obstacle cell [percent]."""


@dataclass(slots=True)
class OccupancyGrid:
    """Occupancy grid. Row 0 has the lowest y, column 0 the lowest x. Images are flipped on reading and writing."""

    data: np.ndarray
    """Occupancy probability, shape (height, width), int8: 0 to 100 [percent], -1 for unknown."""
    resolution: float
    """Side length of a cell [m]."""
    origin: tuple[float, float]
    """Position (x, y) of the outer corner of cell (0, 0) in the grid's frame [m]."""

    def __post_init__(self) -> None:
        if self.data.ndim != 2 or self.data.dtype != np.int8:
            raise ValueError(f"data must be a 2D int8 array, got {self.data.ndim}D {self.data.dtype}")
        if not self.resolution > 0:
            raise ValueError(f"resolution must be positive, got {self.resolution}")

    @property
    def occupied(self) -> np.ndarray:
        """Mask of obstacle cells, of at least `OCCUPIED_FROM` percent: shape of the data, bool."""
        return self.data >= OCCUPIED_FROM

    @property
    def free(self) -> np.ndarray:
        """Mask of known cells without an obstacle: shape of the data, bool."""
        return (self.data >= 0) & (self.data < OCCUPIED_FROM)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Covered area (x_min, y_min, x_max, y_max) [m]."""
        height, width = self.data.shape
        x, y = self.origin
        return x, y, x + width * self.resolution, y + height * self.resolution

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Convert points (x, y), shape (..., 2) [m], to cells (row, column), shape (..., 2), int64.

        Points outside the grid give indices outside the array.
        """
        return np.floor((np.asarray(points)[..., ::-1] - self.origin[::-1]) / self.resolution).astype(np.int64)

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """Convert cells (row, column), shape (..., 2), to centres (x, y), shape (..., 2), float64 [m]."""
        return (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution + self.origin

    def contains(self, cells: np.ndarray) -> np.ndarray:
        """Return whether cells (row, column), shape (..., 2), lie inside the grid: shape (...), bool."""
        cells = np.asarray(cells)
        return np.all((cells >= 0) & (cells < self.data.shape), axis=-1)


def known_window(data: np.ndarray) -> Window:
    """Return the bounding rectangle of the observed cells of an occupancy grid, shape (height, width), int8.

    Without any observed cell, the rectangle is the whole grid.
    """
    rows, cols = (np.flatnonzero(data.max(axis=axis) >= 0).tolist() for axis in (1, 0))
    if not rows:
        return Window(0, 0, *data.shape)
    return Window.spanning((rows[0], cols[0]), (rows[-1], cols[-1]))


def crop_to_known(grid: OccupancyGrid, margin: int = 1) -> OccupancyGrid:
    """Crop a map to its observed part and a border of `margin` cells, without a copy.

    An unobserved map is returned whole.
    """
    window = known_window(grid.data).dilated(margin, grid.data.shape)
    x, y = grid.origin
    origin = x + window.col * grid.resolution, y + window.row * grid.resolution
    return OccupancyGrid(grid.data[window.slices], grid.resolution, origin)


def blocks_of(raster: np.ndarray, side: int, beyond: int) -> np.ndarray:
    """Split a raster, shape (height, width), into square blocks of cells, shape (block rows, block columns, side**2).

    `beyond`: value that fills incomplete blocks at the border.
    """
    padded = np.pad(raster, [(0, -length % side) for length in raster.shape], constant_values=beyond)
    height, width = padded.shape[0] // side, padded.shape[1] // side
    return padded.reshape(height, side, width, side).swapaxes(1, 2).reshape(height, width, side**2)
