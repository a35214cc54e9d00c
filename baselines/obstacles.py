"""What stands in the way right now: obstacles as points in the robot's frame."""

import math

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import LidarParams

OCCUPIED_FROM = 50
"""Least occupancy that is an obstacle [percent]."""
SIGHT_STEP = 0.02
"""Spacing of the places along an arc at which the footprint is tested [m]."""


@njit(cache=True, error_model="numpy")
def _scan_points(scan, range_max, cos, sin, mount_x, mount_y, points):
    """Write the ends of the beams that hit something to `points` (base frame [m]) and return how many there are."""
    count = 0
    for beam in range(scan.shape[0]):
        if 0.0 < scan[beam] < 1.0:
            points[count, 0] = mount_x + scan[beam] * range_max * cos[beam]
            points[count, 1] = mount_y + scan[beam] * range_max * sin[beam]
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _blind_points(data, x0, y0, resolution, pose, mount, half_fov, range_min, range_far, points, count):
    """Append the map's occupied cells that the lidar cannot see: nearer than its least range, or beside its view.

    Args:
        data: shape (height, width), int8, occupancy.
        x0: x of the outer corner of cell (0, 0) [m].
        y0: y of the same [m].
        resolution: side of a cell [m].
        pose: (x, y, theta) of the base in the map.
        mount: (x, y, yaw) of the lidar in the base frame.
        half_fov: half the lidar's field of view [rad].
        range_min: the lidar's least range [m].
        range_far: distance from the lidar up to which cells beside its view are taken [m].
        points: shape (n, 2), float64, written in the base frame [m]; cells that no longer fit are left out.
        count: how many points are there already.

    Returns:
        How many points there are now.
    """
    height, width = data.shape
    c, s = math.cos(pose[2]), math.sin(pose[2])
    sensor_x, sensor_y = pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1]
    row, col = math.floor((sensor_y - y0) / resolution), math.floor((sensor_x - x0) / resolution)
    reach = math.ceil(max(range_min, range_far) / resolution)
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for k in range(max(col - reach, 0), min(col + reach + 1, width)):
            if data[r, k] < OCCUPIED_FROM or count == points.shape[0]:
                continue
            dx, dy = x0 + (k + 0.5) * resolution - sensor_x, y0 + (r + 0.5) * resolution - sensor_y
            distance = math.hypot(dx, dy)
            bearing = (math.atan2(dy, dx) - pose[2] - mount[2] + math.pi) % (2.0 * math.pi) - math.pi
            if distance < range_min or (abs(bearing) > half_fov and distance < range_far):
                points[count, 0] = mount[0] + c * dx + s * dy
                points[count, 1] = mount[1] - s * dx + c * dy
                count += 1
    return count


class ObstacleFinder:
    """Turns scans into points around the robot, and remembers from the map what the lidar is blind to."""

    def __init__(self, lidar: LidarParams, memory: float) -> None:
        """Prepare for a lidar.

        Args:
            lidar: its geometry.
            memory: distance up to which the map speaks for directions that the lidar does not cover [m].
        """
        self._lidar = lidar
        self._memory = memory
        angles = lidar.angles + lidar.mount.yaw
        self._cos, self._sin = np.cos(angles), np.sin(angles)
        self._points = np.empty((lidar.num_beams + 2000, 2))

    def points(self, scan: np.ndarray, pose: Pose2D, grid: OccupancyGrid) -> np.ndarray:
        """Return obstacles in the base frame.

        Args:
            scan: shape (num_beams,), float32: ranges over the greatest range; 1 no return, 0 nothing measured.
            pose: believed pose of the base, map frame.
            grid: the map.

        Returns:
            Shape (n, 2), float64 [m]; valid until the next call.
        """
        lidar, mount = self._lidar, self._lidar.mount
        count = _scan_points(scan, lidar.range_max, self._cos, self._sin, mount.x, mount.y, self._points)
        # A full turn has no directions beside its view; half a beam's width keeps rounding from making one.
        half_fov = 0.5 * lidar.fov + lidar.angle_increment
        count = _blind_points(
            grid.data,
            *grid.origin,
            grid.resolution,
            tuple(pose),
            (mount.x, mount.y, mount.yaw),
            half_fov,
            lidar.range_min,
            self._memory,
            self._points,
            count,
        )
        return self._points[:count]


@njit(cache=True, error_model="numpy")
def free_distance(points, curvature, radius, distance):
    """Tell how far the robot gets along an arc before its footprint touches a point.

    A point that lies within the footprint already (noise, a wall believed too thick) stops only what brings it nearer.

    Args:
        points: shape (n, 2), float64, obstacles in the base frame [m].
        curvature: of the arc, positive to the left [1/m].
        radius: of the footprint [m].
        distance: how far to look along the arc, negative backwards [m].

    Returns:
        The free length of the arc [m], at most `abs(distance)`.
    """
    num_steps = int(abs(distance) / SIGHT_STEP) + 1
    nearest = radius + abs(distance)
    for k in range(points.shape[0]):
        nearest = min(nearest, math.hypot(points[k, 0], points[k, 1]))
    clear = max(nearest - radius, 0.0)
    for step in range(1, num_steps + 1):
        along = abs(distance) * step / num_steps
        # The arc is no shorter than the straight way: up to here the footprint cannot reach the nearest point.
        if along < clear:
            continue
        s = math.copysign(along, distance)
        turn = s * curvature
        if abs(turn) > 1e-6:
            x, y = math.sin(turn) / curvature, (1.0 - math.cos(turn)) / curvature
        else:
            x, y = s, 0.5 * s * turn
        for k in range(points.shape[0]):
            gap = math.hypot(points[k, 0] - x, points[k, 1] - y)
            if gap < radius and gap < math.hypot(points[k, 0], points[k, 1]) - 1e-3:
                return abs(distance) * (step - 1) / num_steps
    return abs(distance)
