"""Conversion from metres to pixels."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D

BORDER = 0.03
"""Width of the border around the world's bounds, as a share of the surface's size."""


class View:
    """Mapping from world coordinates to pixels: uniform scale, y upwards."""

    def __init__(self, bounds: tuple[float, float, float, float], size: tuple[int, int]) -> None:
        """Fit `bounds` (x_min, y_min, x_max, y_max) [m] into `size` (width, height) [px]."""
        x_min, y_min, x_max, y_max = bounds
        width, height = size
        self.size = size
        self.scale = min(width * (1 - 2 * BORDER) / (x_max - x_min), height * (1 - 2 * BORDER) / (y_max - y_min))
        """Pixels per metre."""
        self._left = (x_min + x_max) / 2 - width / 2 / self.scale
        self._top = (y_min + y_max) / 2 + height / 2 / self.scale

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return pixel coordinates, shape (n, 2), float64, of points, shape (n, 2), world frame [m]."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        return (points - (self._left, self._top)) * (self.scale, -self.scale)

    def points(self, pixels: np.ndarray) -> np.ndarray:
        """Return world points, shape (n, 2), float64 [m], of pixel coordinates, shape (n, 2); inverse of `pixels`."""
        return np.reshape(pixels, (-1, 2)) / (self.scale, -self.scale) + (self._left, self._top)

    def paint_grid(self, grid: OccupancyGrid, start: Pose2D, palette: np.ndarray, image: np.ndarray) -> None:
        """Paint an occupancy grid into an image, shape (height, width), uint32.

        `start`: world pose of the map frame. `palette`: pixel values of unknown cells (-1) and of occupancy 0 to 100,
        shape (102,). Pixels outside of the grid are unknown.
        """
        # Three pixel centers define the affine transform to cells.
        pixels = np.array([(0.5, 0.5), (1.5, 0.5), (0.5, 1.5)])
        cells = (start.inverse().transform(self.points(pixels)) - grid.origin) / grid.resolution
        _paint(grid.data, palette, cells[0], cells[1] - cells[0], cells[2] - cells[0], image)


@njit(cache=True, error_model="numpy")
def _paint(data, palette, corner, per_col, per_row, image):
    rows, columns = data.shape
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            column = math.floor(corner[0] + j * per_col[0] + i * per_row[0])
            row = math.floor(corner[1] + j * per_col[1] + i * per_row[1])
            inside = 0 <= row < rows and 0 <= column < columns
            image[i, j] = palette[data[row, column] + 1] if inside else palette[0]
