"""What all maps of the SLAMs share: an occupancy grid that grows towards whatever leaves it."""

import math

import numpy as np

from envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from envs.robots import LidarParams

from ..scans import ScanGeometry, beam_ends

MAX_CELLS = 1 << 27
"""Size at which a map refuses to grow: a diverged estimate must not take all memory."""


class GrowingMap:
    """An occupancy grid around the map frame's origin.

    The map grows by powers of two towards whatever leaves it. `grid` stays the same object; the array in it and its
    origin are replaced when the map grows. Subclasses keep cells of their own beside it, and pad them in `_pad`.
    """

    def __init__(
        self, lidar: LidarParams, resolution: float, size: tuple[float, float], skip_exceeding: bool, block: int = 1
    ) -> None:
        """Make an unknown map with the map frame's origin in its middle.

        Args:
            lidar: geometry of the scans.
            resolution: side of a cell [m].
            size: extent along x and y at the start [m].
            skip_exceeding: whether beams without a return are ignored; else they clear up to the lidar's range.
            block: numbers of columns and rows, and those before the origin, stay multiples of this.

        Raises:
            ValueError: if the map would have more than `MAX_CELLS`.
        """
        if not (size[0] / resolution) * (size[1] / resolution) <= MAX_CELLS:
            raise ValueError(f"a map of {size[0]:g} x {size[1]:g} m in cells of {resolution:g} m has too many of them")
        self.geometry = ScanGeometry.of(lidar, resolution)
        self._skip_exceeding = skip_exceeding
        width, height = (block * math.ceil(length / resolution / block) for length in size)
        self.corner = (-(width // 2) // block * block, -(height // 2) // block * block)
        """Column and row of the first cell, counted from the map frame's origin."""
        self.grid = OccupancyGrid(
            np.full((height, width), UNKNOWN, dtype=np.int8), resolution, self._origin(resolution)
        )
        """The map as an occupancy grid, always up to date."""
        # Room for all cells that a scan may touch; only what is written takes memory.
        most_cells = lidar.num_beams * (math.ceil(lidar.range_max / resolution) + 2)
        self._new_cells = np.empty((most_cells, 2), dtype=np.int32)
        self._ends = np.empty((lidar.num_beams, 3))

    def _origin(self, resolution: float) -> tuple[float, float]:
        return self.corner[0] * resolution, self.corner[1] * resolution

    def to_cells(self, x: float, y: float) -> tuple[float, float]:
        """Return a position in the map frame [m] as distances from the map's corner [cells]."""
        return x / self.grid.resolution - self.corner[0], y / self.grid.resolution - self.corner[1]

    def to_metres(self, x: float, y: float) -> tuple[float, float]:
        """Undo `to_cells`."""
        return (x + self.corner[0]) * self.grid.resolution, (y + self.corner[1]) * self.grid.resolution

    def _make_room(self, ranges: np.ndarray, pose: Pose2D) -> tuple[float, float, tuple[int, int, int, int]]:
        """Write where the beams of a scan end to `_ends`, in a map that is enlarged to hold them.

        Returns:
            The position of the lidar [cells], and what `beam_ends` returns.
        """
        x, y, extent = self._find_ends(ranges, pose)
        if self.grow_to_hold(*extent):
            x, y, extent = self._find_ends(ranges, pose)
        return x, y, extent

    def _find_ends(self, ranges: np.ndarray, pose: Pose2D) -> tuple[float, float, tuple[int, int, int, int]]:
        geometry = self.geometry
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        sensor_x = pose.x + c * geometry.mount_x - s * geometry.mount_y
        sensor_y = pose.y + s * geometry.mount_x + c * geometry.mount_y
        x, y = self.to_cells(sensor_x, sensor_y)
        return x, y, beam_ends(ranges, geometry, self._skip_exceeding, x, y, c, s, self._ends)

    def grow_to_hold(self, col_min: int, row_min: int, col_max: int, row_max: int) -> bool:
        """Enlarge the map such that it has the given columns and rows; return whether it had to be."""
        height, width = self.grid.data.shape
        left, right = _growth(width, col_min, col_max)
        low, high = _growth(height, row_min, row_max)
        if not (left or right or low or high):
            return False
        if (height + low + high) * (width + left + right) > MAX_CELLS:
            raise MemoryError(
                f"the map would need {width + left + right} x {height + low + high} cells of "
                f"{self.grid.resolution} m to hold the last scan; the pose estimate has diverged, or the resolution "
                "is too fine for the world"
            )
        self._pad(((low, high), (left, right)))
        self.corner = (self.corner[0] - left, self.corner[1] - low)
        self.grid.origin = self._origin(self.grid.resolution)
        return True

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        """Add unknown rows (before, after) and columns (before, after)."""
        self.grid.data = np.pad(self.grid.data, margins, constant_values=UNKNOWN)


def _growth(size: int, first: int, last: int) -> tuple[int, int]:
    """Return how many cells to add before and after `size` cells to hold the cells from `first` to `last`.

    Each side in turn multiplies the size by the least sufficient power of two.
    """
    before = after = 0
    while -first > before:
        before = 2 * before + size
    size += before
    while last + before >= size + after:
        after = 2 * after + size
    return before, after
