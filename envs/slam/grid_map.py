"""The occupancy grid map that scans are integrated into."""

import math

import numpy as np
from numba import njit

from envs.estimation import MapUpdate, Window
from envs.geometry import UNKNOWN, OccupancyGrid, Pose2D, wrap_angle
from envs.geometry.pose import distance
from envs.robots import LidarParams

from .cells import unvisited_word
from .map_update import AVG, BASE, REPORT, InverseSensorModel, integrate_scan
from .params import TinySlamParams
from .scans import ScanGeometry, beam_ends

MAX_CELLS = 1 << 27
"""Size at which a map refuses to grow: a diverged estimate must not take all memory."""


@njit(cache=True, error_model="numpy")
def has_moved(x, y, theta, new_x, new_y, new_theta, min_distance, min_angle):
    """Tell whether two poses are `min_distance` [m] or `min_angle` [rad] or more apart."""
    return distance(new_x - x, new_y - y) >= min_distance or abs(wrap_angle(new_theta - theta)) >= min_angle


class GridMap:
    """Cells that accumulate observations of beams, and the occupancy grid that follows from them.

    The map grows by powers of two towards whatever leaves it. `grid` stays the same object; the array in it and its
    origin are replaced when the map grows.
    """

    def __init__(self, params: TinySlamParams, lidar: LidarParams) -> None:
        """Make an unknown map with the map frame's origin in its middle."""
        self._params = params
        self.geometry = ScanGeometry.of(lidar, params.resolution)
        self.model = InverseSensorModel(
            {"avg": AVG, "base": BASE, "report": REPORT}[params.cell],
            params.estimator == "area",
            float(params.occupied_prob),
            float(params.empty_prob),
            params.hole_width / params.resolution,
            params.blur == "add",
        )
        self.unvisited = unvisited_word(params.unvisited)
        width, height = (math.ceil(size / params.resolution) for size in (params.map_width, params.map_height))
        self.corner = (-(width // 2), -(height // 2))
        self.words = np.full((height, width), self.unvisited, dtype=np.int32)
        """Shape (height, width), int32: the cells."""
        self.grid = OccupancyGrid(np.full((height, width), UNKNOWN, dtype=np.int8), params.resolution, self._origin)
        """The same as an occupancy grid, always up to date."""
        # Room for all cells that a scan may touch; only what is written takes memory.
        most_cells = lidar.num_beams * (math.ceil(lidar.range_max / params.resolution) + 2)
        self._new_cells = np.empty((most_cells, 2), dtype=np.int32)
        self._ends = np.empty((lidar.num_beams, 3))

    @property
    def _origin(self) -> tuple[float, float]:
        return self.corner[0] * self._params.resolution, self.corner[1] * self._params.resolution

    def integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        """Integrate a scan, shape (num_beams,), float32 [m], taken at a pose of the base, with a weight from 0 to 1."""
        x, y, extent = self._find_ends(ranges, pose)
        if self.grow_to_hold(*extent):
            x, y, extent = self._find_ends(ranges, pose)
        new_cells = self._new_cells
        count = integrate_scan(self.words, self.grid.data, self._ends, x, y, self.model, float(quality), new_cells)
        return MapUpdate(new_cells[:count].copy(), Window(*extent), origin=self.grid.origin)

    def _find_ends(self, ranges: np.ndarray, pose: Pose2D) -> tuple[float, float, tuple[int, int, int, int]]:
        """Find where beams end; return the position of the lidar [cells], and what `beam_ends` returns."""
        geometry = self.geometry
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        sensor_x = pose.x + c * geometry.mount_x - s * geometry.mount_y
        sensor_y = pose.y + s * geometry.mount_x + c * geometry.mount_y
        x, y = self.to_cells(sensor_x, sensor_y)
        return x, y, beam_ends(ranges, geometry, self._params.skip_exceeding, x, y, c, s, self._ends)

    def to_cells(self, x: float, y: float) -> tuple[float, float]:
        """Return a position in the map frame [m] as distances from the map's corner [cells]."""
        return x / self._params.resolution - self.corner[0], y / self._params.resolution - self.corner[1]

    def to_metres(self, x: float, y: float) -> tuple[float, float]:
        """Undo `to_cells`."""
        return (x + self.corner[0]) * self._params.resolution, (y + self.corner[1]) * self._params.resolution

    def grow_to_hold(self, col_min: int, row_min: int, col_max: int, row_max: int) -> bool:
        """Enlarge the map such that it has the given columns and rows; return whether it had to be."""
        height, width = self.words.shape
        left, right = _growth(width, col_min, col_max)
        low, high = _growth(height, row_min, row_max)
        if not (left or right or low or high):
            return False
        if (height + low + high) * (width + left + right) > MAX_CELLS:
            raise MemoryError(
                f"the map would need {width + left + right} x {height + low + high} cells of "
                f"{self._params.resolution} m to hold the last scan; the pose estimate has diverged, or the resolution "
                "is too fine for the world"
            )
        margins = ((low, high), (left, right))
        self.words = np.pad(self.words, margins, constant_values=self.unvisited)
        self.grid.data = np.pad(self.grid.data, margins, constant_values=UNKNOWN)
        self.corner = (self.corner[0] - left, self.corner[1] - low)
        self.grid.origin = self._origin
        return True


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
