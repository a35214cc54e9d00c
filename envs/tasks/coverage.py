import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import MapUpdate
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.raycast import polar
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.worlds import ExplorableArea

EXPLORABLE, KNOWN, SEEN = 1, 2, 4
"""Bit flags of a cell in the world's raster: can be explored; is known in the map; was observed from the true pose."""
EXPLORED = EXPLORABLE | KNOWN | SEEN
POLAR_MARGIN = 1e-4
"""Bound of the error of an approximate bearing [rad]."""
TOLERANCE = 2.0
"""Maximum distance between a beam and a point that it observes [raster cells]."""


class Frame(NamedTuple):
    """Origin (x, y) of a grid, and size of a cell [m]."""

    x: float
    y: float
    resolution: float


class TrueScan(NamedTuple):
    """Lidar scan with the true position (x, y) of the lidar, world frame [m]."""

    ranges: np.ndarray
    """Ranges, shape (num_beams,), float32 [m]."""
    x: float
    y: float
    theta: float
    """True direction of the first beam, world frame [rad]."""
    increment: float
    """Angle between neighbouring beams [rad]."""
    is_full_turn: bool
    """Whether the first and last beams are neighbours."""
    range_max: float


@njit(cache=True, error_model="numpy")
def _reaches(scan, first, last, distance, tolerance):
    num_beams = scan.ranges.shape[0]
    turn = num_beams if scan.is_full_turn else round(2.0 * math.pi / scan.increment)
    for index in range(first, last + 1):
        beam = index if 0 <= index < turn else index % turn
        if beam < num_beams and scan.ranges[beam] + tolerance >= distance:
            return True
    return False


@njit(cache=True, error_model="numpy")
def sees(scan, x, y, tolerance):
    """Return True if a beam passes or ends within `tolerance` [m] of the point (x, y), world frame."""
    dx, dy = x - scan.x, y - scan.y
    distance = math.sqrt(dx * dx + dy * dy)
    if distance <= tolerance or distance > scan.range_max + tolerance:
        return distance <= tolerance
    turn, ratio, per_radian = 2.0 * math.pi, tolerance / distance, 1.0 / scan.increment
    # upper bound of the arc sine
    spread = 1.05 * ratio if ratio < 0.5 else math.asin(ratio)
    is_dense = distance * scan.increment <= 2.0 * tolerance
    # The approximate bearing decides for most points.
    bearing = polar(dx, dy) - scan.theta
    bearing -= turn * math.floor(bearing / turn)  # faster than %
    if POLAR_MARGIN < bearing < turn - POLAR_MARGIN:
        low, high = (bearing - POLAR_MARGIN) * per_radian, (bearing + POLAR_MARGIN) * per_radian
        nearest = int(low)
        is_sure = is_dense and nearest == int(high) and nearest < scan.ranges.shape[0]
        if is_sure and scan.ranges[nearest] + tolerance >= distance:
            return True
        first, last = low - spread * per_radian, high + spread * per_radian
        if not _reaches(scan, math.floor(first), math.ceil(last), distance, tolerance):
            return False
    bearing = (math.atan2(dy, dx) - scan.theta) % turn
    first, last = (bearing - spread) / scan.increment, (bearing + spread) / scan.increment
    beams = (math.floor(first), math.ceil(last)) if is_dense else (math.ceil(first), math.floor(last))
    return _reaches(scan, beams[0], beams[1], distance, tolerance)


@njit(cache=True, error_model="numpy")
def mark_known(new_cells, map_frame, start, cells, frame, scan, pending, num_pending):
    """Update the explored cells of the world after new cells appeared in the map.

    A cell is explored if the map contains it and a scan observed it. `new_cells`: new map cells (row, column), shape
    (k, 2), int32; `start`: pose of the map frame, world frame; `pending`: the `num_pending` world cells (row, column)
    that are known but not observed, shape (n, 2), int32. Returns the number of newly explored cells, and the new
    `num_pending`.
    """
    height, width = cells.shape
    # affine transform from map cells to raster cells
    scale = map_frame.resolution / frame.resolution
    c, s = math.cos(start[2]) * scale, math.sin(start[2]) * scale
    u, v = map_frame.x / map_frame.resolution, map_frame.y / map_frame.resolution
    first_col = (start[0] - frame.x) / frame.resolution + c * u - s * v
    first_row = (start[1] - frame.y) / frame.resolution + s * u + c * v
    tolerance = TOLERANCE * frame.resolution
    count = 0
    for k in range(new_cells.shape[0]):
        # At any rotation, four points per map cell cover all raster cells.
        for quarter in range(4):
            u, v = new_cells[k, 1] + 0.25 + 0.5 * (quarter & 1), new_cells[k, 0] + 0.25 + 0.5 * (quarter >> 1)
            x, y = first_col + c * u - s * v, first_row + s * u + c * v
            row, col = math.floor(y), math.floor(x)
            if not (0 <= row < height and 0 <= col < width and cells[row, col] & EXPLORABLE):
                continue
            if cells[row, col] == EXPLORED:
                continue
            is_seen = cells[row, col] & SEEN > 0
            if is_seen or sees(scan, frame.x + x * frame.resolution, frame.y + y * frame.resolution, tolerance):
                cells[row, col] = EXPLORED
                count += 1
            elif not cells[row, col] & KNOWN:
                cells[row, col] |= KNOWN
                pending[num_pending, 0], pending[num_pending, 1] = row, col
                num_pending += 1
    return count, num_pending


@njit(cache=True, error_model="numpy")
def mark_seen(cells, frame, scan, pending, num_pending):
    """Mark known cells of the world as explored if a scan observes them.

    `pending`: known cells (row, column) that are not observed. Returns the number of newly explored and of pending
    cells.
    """
    tolerance = TOLERANCE * frame.resolution
    count = kept = 0
    for k in range(num_pending):
        row, col = pending[k]
        if cells[row, col] == EXPLORED:
            continue
        if sees(scan, frame.x + (col + 0.5) * frame.resolution, frame.y + (row + 0.5) * frame.resolution, tolerance):
            cells[row, col] = EXPLORED
            count += 1
        else:
            pending[kept, 0], pending[kept, 1] = row, col
            kept += 1
    return count, kept


class Coverage:
    """Explored part of the explorable area, measured in the true world.

    A cell is explored if (1) the map contains it at its true position, and (2) a scan from the robot's true pose
    observed it when it was mapped, or later.
    """

    def __init__(self, area: ExplorableArea, start: Pose2D, lidar: LidarParams) -> None:
        """Begin with no explored cells. `start`: true pose of the map frame in the world."""
        self.area = area
        self.start = start
        self._mount = lidar.mount
        self._first_angle = float(lidar.mount.yaw), lidar.angle_min
        is_full_turn = bool(lidar.fov > 2.0 * math.pi - 1.5 * lidar.angle_increment)
        self._beams = float(lidar.angle_increment), is_full_turn, float(lidar.range_max)
        self._frame = Frame(float(area.walls.origin[0]), float(area.walls.origin[1]), float(area.walls.resolution))
        self._cells = area.explorable.astype(np.uint8)
        self._num_explorable = int(np.count_nonzero(area.explorable))
        self._pending = np.empty((self._num_explorable, 2), dtype=np.int32)
        self._num_pending = 0
        self._num_explored = 0

    def update(self, update: MapUpdate, resolution: float, ranges: np.ndarray, true_pose: Pose2D) -> float:
        """Process a map update; return the change of the explored area [m2], negative after corrections.

        `resolution`: size of a map cell [m]; `ranges`: shape (num_beams,), float32 [m]; `true_pose`: base pose, world
        frame.
        """
        if update.window is None and not update.redrawn:
            return 0.0
        before, scan = self._num_explored, self._true_scan(ranges, true_pose)
        cells, frame, pending = self._cells, self._frame, self._pending
        if update.redrawn:
            cells &= EXPLORABLE | SEEN
            self._num_explored = self._num_pending = 0
        if self._num_pending:
            count, self._num_pending = mark_seen(cells, frame, scan, pending, self._num_pending)
            self._num_explored += count
        if len(update.new_cells):
            map_frame = Frame(float(update.origin[0]), float(update.origin[1]), float(resolution))
            known = cells, frame, scan, pending, self._num_pending
            count, self._num_pending = mark_known(update.new_cells, map_frame, self.start, *known)
            self._num_explored += count
        return float((self._num_explored - before) * frame.resolution**2)

    @property
    def explored(self) -> np.ndarray:
        """Mask of explored cells on the world's raster: shape (height, width), bool."""
        return self._cells == EXPLORED

    @property
    def explored_area(self) -> float:
        """Explored part of the explorable area [m2]."""
        return float(self._num_explored * self._frame.resolution**2)

    @property
    def explored_fraction(self) -> float:
        """Explored fraction of the explorable area."""
        return self._num_explored / self._num_explorable

    def _true_scan(self, ranges: np.ndarray, pose: Pose2D) -> TrueScan:
        mount, (yaw, angle_min) = self._mount, self._first_angle
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        x, y = pose.x + c * mount.x - s * mount.y, pose.y + s * mount.x + c * mount.y
        return TrueScan(ranges, x, y, pose.theta + yaw + angle_min, *self._beams)


def map_iou(grid: OccupancyGrid, area: ExplorableArea, start: Pose2D) -> float:
    """Return the intersection over union of occupied map cells and visible true walls.

    Cells match within 0.1 m. `start` is the pose of the map frame, world frame.
    """
    walls = area.walls
    wall = walls.data > 0
    visible_wall = wall & ndimage.binary_dilation(area.explorable, np.ones((3, 3), dtype=bool))
    cells = walls.cells(start.transform(grid.centers(np.argwhere(grid.occupied))))
    inside = walls.contains(cells)
    mapped = np.zeros_like(wall)
    mapped[tuple(cells[inside].T)] = True
    reach = 0.1 / walls.resolution
    near_wall = ndimage.distance_transform_edt(~wall) <= reach
    near_mapped = ndimage.distance_transform_edt(~mapped) <= reach if mapped.any() else np.zeros_like(wall)
    hits = int(np.count_nonzero(visible_wall & near_mapped))
    misses = int(np.count_nonzero(visible_wall)) - hits
    false = int(np.count_nonzero(mapped & ~near_wall)) + int(np.count_nonzero(~inside))
    return hits / max(hits + misses + false, 1)
