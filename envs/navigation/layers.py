"""The layered costmap: a map made beforehand, what scans have found since, and inflation over both."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D
from envs.geometry.distance_transform import squared_distances
from envs.geometry.lines import next_cell, start_walk
from envs.robots import LidarParams

from .costmap import Costmap, CostmapParams, Inflation, Window, union


@dataclass(frozen=True, slots=True)
class ObstacleParams:
    """What scans do to the obstacle layer. Defaults: Nav2's, but for `same_obstacle`."""

    marking_range: float = 2.5
    """Hits up to this range are marked [m] (`obstacle_max_range`)."""
    clearing_range: float = 3.0
    """Beams clear what they pass up to this range [m] (`raytrace_max_range`)."""
    same_obstacle: float = 0.15
    """Hits this near to an obstacle of the static map are that obstacle, seen from a pose that is a little wrong [m].
    Nav2 marks them too, and narrow doors close."""

    def __post_init__(self) -> None:
        for name in ("marking_range", "clearing_range"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if not self.same_obstacle >= 0:
            raise ValueError(f"same_obstacle must not be negative, got {self.same_obstacle}")


@njit(cache=True, error_model="numpy")
def _clear_beam(layer, x, y, dx, dy, length):
    """Set the cells on a beam to free, from (x, y) for `length` along the unit vector (dx, dy), all in cells."""
    height, width = layer.shape
    walk = start_walk(x, y, x + length * dx, y + length * dy)
    while 0 <= walk.row < height and 0 <= walk.col < width:
        layer[walk.row, walk.col] = FREE
        if walk.rows_left + walk.cols_left == 0:
            break
        walk = next_cell(walk)


@njit(cache=True, error_model="numpy")
def mark_and_clear(layer, is_static, sensor, beams, marking, clearing):
    """Take a scan into the obstacle layer: all beams clear first, then all hits mark.

    Args:
        layer: shape (height, width), int8: -1 never seen, 0 seen free, 100 marked; changed.
        is_static: same shape, bool: where hits belong to an obstacle of the static map.
        sensor: column and row [cells], heading [rad].
        beams: angle of the first one [rad], from one to the next [rad], and their ranges (shape (num_beams,), [cells]:
            inf for no return; NaN, or anything negative, is ignored).
        marking: range up to which hits mark [cells].
        clearing: range up to which beams clear [cells].
    """
    height, width = layer.shape
    x, y, theta = sensor
    angle_min, angle_increment, ranges = beams
    for beam in range(ranges.shape[0]):
        if not ranges[beam] >= 0.0:
            continue
        angle = theta + angle_min + beam * angle_increment
        # A cell's width before the hit, so that the noise of a wall's ranges does not clear the wall.
        length = min(ranges[beam] - 1.0, clearing)
        if length > 0.0:
            _clear_beam(layer, x, y, math.cos(angle), math.sin(angle), length)
    for beam in range(ranges.shape[0]):
        if not 0.0 <= ranges[beam] <= marking:
            continue
        angle = theta + angle_min + beam * angle_increment
        col = math.floor(x + ranges[beam] * math.cos(angle))
        row = math.floor(y + ranges[beam] * math.sin(angle))
        if 0 <= row < height and 0 <= col < width and not is_static[row, col]:
            layer[row, col] = OCCUPIED


class LayeredCostmap:
    """Costs over a known map that scans keep up to date.

    Three layers as in Nav2: the static map; obstacles that scans mark and clear; inflation. Cells that neither map nor
    scans know stay unknown. Scans change only what lies around the robot, so only that is inflated anew, when the
    costs are next asked for.
    """

    def __init__(
        self, static: OccupancyGrid, params: CostmapParams, obstacles: ObstacleParams = ObstacleParams()
    ) -> None:
        """Lay the layers.

        Args:
            static: the map; must not change afterwards.
            params: how obstacles spread.
            obstacles: what scans do.
        """
        self.static = static
        """The map."""
        self._params = params
        self._obstacles = obstacles
        self._inflation = Inflation.of(params, static.resolution)
        self._layer: np.ndarray = np.full(static.data.shape, UNKNOWN, dtype=np.int8)
        reach = math.floor(obstacles.same_obstacle / static.resolution + 1e-9)
        occupied = static.data >= params.occupied_from
        self._is_static = squared_distances(occupied, reach) <= reach**2 if reach else occupied
        self._combined = OccupancyGrid(static.data.copy(), static.resolution, static.origin)
        self._costmap = Costmap(self._inflation.costs(static.data), self._combined, params)
        self._stale: Window | None = None

    @property
    def costmap(self) -> Costmap:
        """The costs now. The same arrays are brought up to date by every call; copy what must outlive the next one."""
        if self._stale is not None:
            self._refresh(*self._stale)
            self._stale = None
        return self._costmap

    @property
    def num_marked(self) -> int:
        """How many cells of the obstacle layer are marked."""
        return int(np.count_nonzero(self._layer == OCCUPIED))

    def update(self, pose: Pose2D, ranges: np.ndarray, lidar: LidarParams) -> None:
        """Take in a scan.

        Args:
            pose: of the robot's base, map frame.
            ranges: shape (num_beams,), [m]: inf for no return, NaN for beams to ignore.
            lidar: geometry of the scan.

        Raises:
            ValueError: if the pose is not finite, or the scan has another number of beams.
        """
        if not all(map(math.isfinite, pose)):
            raise ValueError(f"pose must be finite, got {tuple(pose)}")
        if ranges.shape != (lidar.num_beams,):
            raise ValueError(f"ranges must have shape ({lidar.num_beams},), got {ranges.shape}")
        sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
        x, y = self._in_cells(sensor.x, sensor.y)
        resolution = self.static.resolution
        marking, clearing = self._obstacles.marking_range / resolution, self._obstacles.clearing_range / resolution
        beams = lidar.angle_min, lidar.angle_increment, ranges / resolution
        mark_and_clear(self._layer, self._is_static, (x, y, sensor.theta), beams, marking, clearing)
        self._spoil(x, y, max(marking, clearing))

    def mark(self, points: np.ndarray) -> None:
        """Mark obstacles that no scan shows, as what the bumper touched: shape (n, 2), map frame [m]."""
        cells = self.static.cells(points)
        for row, col in cells[self.static.contains(cells)]:
            if not self._is_static[row, col]:
                self._layer[row, col] = OCCUPIED
                self._spoil(col + 0.5, row + 0.5, 1.0)

    def clear(self) -> None:
        """Forget all that scans have found."""
        self._layer[:] = UNKNOWN
        height, width = self._layer.shape
        self._stale = (0, 0, height, width)

    def clear_around(self, x: float, y: float, radius: float) -> None:
        """Forget what scans have found within a square around (x, y), map frame, of half the side `radius` [m]."""
        (col, row), reach = self._in_cells(x, y), radius / self.static.resolution
        top, left, bottom, right = self._window(col, row, reach)
        self._layer[top:bottom, left:right] = UNKNOWN
        self._spoil(col, row, reach)

    def _in_cells(self, x: float, y: float) -> tuple[float, float]:
        (x0, y0), resolution = self.static.origin, self.static.resolution
        return (x - x0) / resolution, (y - y0) / resolution

    def _window(self, x: float, y: float, reach: float) -> Window:
        """Return top, left, bottom and right of the raster around (x, y), a cell beyond `reach` [cells]."""
        height, width = self._layer.shape
        left, top = max(math.floor(x - reach) - 1, 0), max(math.floor(y - reach) - 1, 0)
        right, bottom = min(math.ceil(x + reach) + 1, width), min(math.ceil(y + reach) + 1, height)
        return top, left, max(bottom, top), max(right, left)

    def _spoil(self, x: float, y: float, reach: float) -> None:
        """Take note that the layer may have changed within `reach` of (x, y) [cells]."""
        self._stale = union(self._stale, self._window(x, y, reach))

    def _refresh(self, top: int, left: int, bottom: int, right: int) -> None:
        """Bring the costs up to date after a change of the layer within a window [cells]."""
        inner = np.s_[top:bottom, left:right]
        static, seen = self.static.data[inner], self._layer[inner]
        # Obstacles of either; else the static map where it is known, else scans.
        is_seen = (static < 0) | ((seen == OCCUPIED) & (static < self._params.occupied_from))
        self._combined.data[inner] = np.where(is_seen, seen, static)
        # Costs change up to the inflation's reach beyond it, and depend on what lies as far beyond that.
        reach = self._inflation.reach
        top, left, bottom, right = max(top - reach, 0), max(left - reach, 0), bottom + reach, right + reach
        rim_top, rim_left = max(top - reach, 0), max(left - reach, 0)
        costs = self._inflation.costs(self._combined.data[rim_top : bottom + reach, rim_left : right + reach])
        costs = costs[top - rim_top : bottom - rim_top, left - rim_left : right - rim_left]
        self._costmap.costs[top:bottom, left:right] = costs
