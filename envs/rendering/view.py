"""From metres to pixels."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D

MARGIN = 0.03
"""Free border around the world's bounds, as a share of the surface's sides."""


class View:
    """A piece of the world on a surface: uniform scale, y upwards, bounds centred."""

    def __init__(self, bounds: tuple[float, float, float, float], size: tuple[int, int]) -> None:
        """Fit `bounds` (x_min, y_min, x_max, y_max) [m] into a surface of `size` (width, height) [px]."""
        x_min, y_min, x_max, y_max = bounds
        width, height = size
        self.size = size
        self.scale = min(width * (1 - 2 * MARGIN) / (x_max - x_min), height * (1 - 2 * MARGIN) / (y_max - y_min))
        """Pixels per metre."""
        self._left = (x_min + x_max) / 2 - width / 2 / self.scale
        self._top = (y_min + y_max) / 2 + height / 2 / self.scale

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return where points (shape (n, 2), world frame [m]) lie on the surface: shape (n, 2), float64 [px]."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        return (points - (self._left, self._top)) * (self.scale, -self.scale)

    def paint_grid(self, grid: OccupancyGrid, start: Pose2D, palette: np.ndarray, image: np.ndarray) -> None:
        """Paint a map, whose frame lies at `start`, over an image, shape (height, width), uint32; beyond is unknown.

        `palette`: shape (102,), uint32, the pixel for each occupancy value from -1 to 100.
        """
        # Three pixel centres tell the affine map from pixels to cells.
        pixels = np.array([(0.5, 0.5), (1.5, 0.5), (0.5, 1.5)])
        world = pixels / (self.scale, -self.scale) + (self._left, self._top)
        cells = (start.inverse().transform(world) - grid.origin) / grid.resolution
        _paint(grid.data, palette, cells[0], cells[1] - cells[0], cells[2] - cells[0], image)


@njit(cache=True, error_model="numpy")
def _paint(data, palette, corner, per_col, per_row, image):
    """Give every pixel the colour of the cell under its centre.

    The first pixel's centre lies at `corner` (column, row); image columns and rows go on by `per_col` and `per_row`
    [cells].
    """
    rows, columns = data.shape
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            column = math.floor(corner[0] + j * per_col[0] + i * per_row[0])
            row = math.floor(corner[1] + j * per_col[1] + i * per_row[1])
            inside = 0 <= row < rows and 0 <= column < columns
            image[i, j] = palette[data[row, column] + 1] if inside else palette[0]
