import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Correction, MapUpdate
from lidarnaut.envs.estimation.scan_points import ScanGeometry
from lidarnaut.envs.geometry import UNKNOWN, OccupancyGrid, Window
from lidarnaut.envs.robots import LidarParams

from .scans import scans_window
from .slam_params import SlamParams

MAX_CELLS = 1 << 27
"""Maximum number of map cells, which limits memory if the pose estimate diverges."""


@njit(cache=True, error_model="numpy")
def to_rows_and_columns(cells, width):
    """Replace flat indices in the first column of `cells`, shape (n, 2), by row and column; `width` of the grid."""
    for k in range(cells.shape[0]):
        index = cells[k, 0]
        cells[k, 0], cells[k, 1] = index // width, index % width


class GrowingMap:
    """Occupancy grid that starts around the map frame's origin and grows when a scan leaves it.

    Width and height grow by powers of two. Growth replaces `grid.data` and `grid.origin`; subclasses pad their cells in
    `_pad`.
    """

    def __init__(self, params: SlamParams, lidar: LidarParams, block: int = 1) -> None:
        """Create an unknown map whose sides and corner are multiples of `block` cells.

        Raises:
            ValueError: if the map exceeds `MAX_CELLS`.
        """
        resolution, size = params.resolution, (params.map_width, params.map_height)
        if not (size[0] / resolution) * (size[1] / resolution) <= MAX_CELLS:
            raise ValueError(f"a map of {size[0]:g} x {size[1]:g} m has too many cells of {resolution:g} m")
        self.geometry = ScanGeometry.of(lidar, resolution, params.skip_exceeding)
        width, height = (block * math.ceil(length / resolution / block) for length in size)
        self.corner = (-(width // 2) // block * block, -(height // 2) // block * block)
        """Column and row of the map's first cell, relative to the map frame's origin."""
        cells = np.full((height, width), UNKNOWN, dtype=np.int8)
        self.grid = OccupancyGrid(cells, resolution, self._origin(resolution))
        # Untouched pages use no memory.
        most_cells = min(lidar.num_beams * (math.ceil(lidar.range_max / resolution) + 2), MAX_CELLS)
        self._cells = np.empty((most_cells, 2), dtype=np.int32), np.empty((most_cells, 2), dtype=np.int32)
        self._ends = np.empty((lidar.num_beams, 3))

    def _origin(self, resolution: float) -> tuple[float, float]:
        return self.corner[0] * resolution, self.corner[1] * resolution

    def to_cells(self, x: float, y: float) -> tuple[float, float]:
        """Convert a position in the map frame [m] to cells from the map's corner."""
        return x / self.grid.resolution - self.corner[0], y / self.grid.resolution - self.corner[1]

    def to_metres(self, x: float, y: float) -> tuple[float, float]:
        return (x + self.corner[0]) * self.grid.resolution, (y + self.corner[1]) * self.grid.resolution

    def _make_room(self, ranges: np.ndarray, poses: np.ndarray) -> Window:
        window = scans_window(ranges, poses, self.geometry, self.corner, self._ends)
        if self.grow_to_hold(window):
            window = scans_window(ranges, poses, self.geometry, self.corner, self._ends)
        return window

    def grow_to_hold(self, window: Window) -> bool:
        """Enlarge the map to contain a block of cells, if necessary; return True if enlarged."""
        height, width = self.grid.data.shape
        left, right = _growth(width, window.col, window.col + window.width - 1)
        low, high = _growth(height, window.row, window.row + window.height - 1)
        if not (left or right or low or high):
            return False
        if (height + low + high) * (width + left + right) > MAX_CELLS:
            cells = f"{width + left + right} x {height + low + high} cells of {self.grid.resolution} m"
            cause = "the pose estimate has diverged, or the resolution is too fine for the world"
            raise MemoryError(f"the map would need {cells} to hold the last scan; {cause}")
        self._pad(((low, high), (left, right)))
        self.corner = (self.corner[0] - left, self.corner[1] - low)
        self.grid.origin = self._origin(self.grid.resolution)
        return True

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        self.grid.data = np.pad(self.grid.data, margins, constant_values=UNKNOWN)

    def _updated(self, window: Window, counts: tuple[int, int]) -> MapUpdate:
        (new_cells, changed_cells), (num_new, num_changed), origin = self._cells, counts, self.grid.origin
        return MapUpdate(new_cells[:num_new].copy(), window, False, origin, None, changed_cells[:num_changed].copy())

    def redrawn(self, correction: Correction | None = None) -> MapUpdate:
        """Return the update for a map with other content than before: all known cells."""
        data = self.grid.data
        known = np.flatnonzero(data != UNKNOWN)
        cells = np.empty((len(known), 2), dtype=np.int32)
        np.divmod(known, data.shape[1], out=(cells[:, 0], cells[:, 1]), casting="unsafe")
        return MapUpdate(cells, Window(0, 0, *data.shape), redrawn=True, origin=self.grid.origin, correction=correction)


def _growth(size: int, first: int, last: int) -> tuple[int, int]:
    before = after = 0
    while -first > before:
        before = 2 * before + size
    size += before
    while last + before >= size + after:
        after = 2 * after + size
    return before, after
