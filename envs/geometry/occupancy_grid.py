"""Occupancy grids as ROS has them: -1 unknown, 0 to 100 the probability of being occupied in percent."""

from dataclasses import dataclass

import numpy as np

UNKNOWN = -1
"""Cell value of what has never been observed."""
FREE = 0
"""Cell value of certainly free space."""
OCCUPIED = 100
"""Cell value of certainly occupied space."""
OCCUPIED_FROM = 50
"""Least occupancy of a cell that is an obstacle, and blocks the view [percent]; known cells below are free."""


@dataclass(slots=True)
class OccupancyGrid:
    """A raster of occupancy over the plane.

    Row 0 holds the lowest y, column 0 the lowest x. Image files store rows the other way round; they are flipped
    where files are read and written, nowhere else.
    """

    data: np.ndarray
    """Shape (height, width), int8: -1 unknown, 0..100 occupied [percent]."""
    resolution: float
    """Side of a cell [m]."""
    origin: tuple[float, float]
    """Position (x, y) of the outer corner of cell (0, 0) in the grid's frame [m]."""

    def __post_init__(self) -> None:
        if self.data.ndim != 2 or self.data.dtype != np.int8:
            raise ValueError(f"data must be a 2D int8 array, got {self.data.ndim}D {self.data.dtype}")
        if not self.resolution > 0:
            raise ValueError(f"resolution must be positive, got {self.resolution}")

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """The area covered: (x_min, y_min, x_max, y_max) [m]."""
        height, width = self.data.shape
        x, y = self.origin
        return x, y, x + width * self.resolution, y + height * self.resolution

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Return the cells that contain points, shape (..., 2), (x, y) [m]: shape (..., 2), int64, (row, column).

        Cells of points outside the grid lie outside the array.
        """
        return np.floor((np.asarray(points)[..., ::-1] - self.origin[::-1]) / self.resolution).astype(np.int64)

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """Return the centres, shape (..., 2), float64, (x, y) [m], of cells, shape (..., 2), (row, column)."""
        return (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution + self.origin

    def contains(self, cells: np.ndarray) -> np.ndarray:
        """Tell which cells (shape (..., 2), (row, column)) lie inside the array: shape (...), bool."""
        cells = np.asarray(cells)
        return np.all((cells >= 0) & (cells < self.data.shape), axis=-1)
