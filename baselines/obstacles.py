"""What stands in the way right now: obstacles as points in the robot's frame, independent of any map."""

import math

import numpy as np
from numba import njit

from envs.robots import RobotParams

SIGHT_STEP = 0.02
"""Spacing of the places along an arc at which the footprint is tested [m]."""
SAME_PLACE = 0.02
"""Distance up to which two remembered points count as one [m]."""
CAPACITY = 1000
"""Points of scans that are remembered at most."""
BUMP_POINTS = 5
"""Points that stand for what the bumper touched."""


@njit(cache=True, error_model="numpy")
def scan_points(scan, range_max, cos, sin, mount_x, mount_y, points):
    """Write the ends of the beams that hit something into `points` and return how many there are.

    Args:
        scan: shape (num_beams,), float32: ranges over the greatest range; 1 no return, 0 nothing measured.
        range_max: the lidar's greatest range [m].
        cos: shape (num_beams,), of the beams' angles in the base frame.
        sin: the same.
        mount_x: position of the lidar in the base frame [m].
        mount_y: the same.
        points: shape (n, 2), float64, written in the base frame [m].
    """
    count = 0
    for beam in range(scan.shape[0]):
        if 0.0 < scan[beam] < 1.0:
            points[count, 0] = mount_x + scan[beam] * range_max * cos[beam]
            points[count, 1] = mount_y + scan[beam] * range_max * sin[beam]
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def remember(points, num_remembered, num_points, dx, dy, dtheta, mount, half_fov, range_min, range_far):
    """Carry points along with the robot's motion and keep those that the lidar no longer sees.

    Args:
        points: shape (n, 2), float64, base frame before the motion [m]; rewritten in the base frame after it.
        num_remembered: how many of them had been remembered before; the others come from the last scan.
        num_points: how many there are.
        dx: motion of the base, in the base frame before it [m].
        dy: the same [m].
        dtheta: the same [rad].
        mount: (x, y, yaw) of the lidar in the base frame.
        half_fov: half the lidar's field of view [rad].
        range_min: the lidar's least range [m].
        range_far: distance from the lidar up to which points beside its view are kept [m].

    Returns:
        How many are kept, at the start of `points`; at most `CAPACITY`.
    """
    c, s = math.cos(dtheta), math.sin(dtheta)
    kept = 0
    for k in range(num_points):
        u, v = points[k, 0] - dx, points[k, 1] - dy
        x, y = c * u + s * v, c * v - s * u
        distance = math.hypot(x - mount[0], y - mount[1])
        is_hidden = distance < range_min
        if not is_hidden and distance < range_far:
            bearing = math.atan2(y - mount[1], x - mount[0]) - mount[2]
            is_hidden = abs((bearing + math.pi) % (2.0 * math.pi) - math.pi) > half_fov
        if not is_hidden or kept == CAPACITY:
            continue
        is_new = True
        if k >= num_remembered:
            for other in range(kept):
                if abs(points[other, 0] - x) < SAME_PLACE and abs(points[other, 1] - y) < SAME_PLACE:
                    is_new = False
                    break
        if is_new:
            points[kept, 0], points[kept, 1] = x, y
            kept += 1
    return kept


class ObstacleMemory:
    """Obstacles around the robot: the last scan, and what the lidar saw before it came too near or out of view.

    What it remembers moves along by odometry, so that a map which has drifted cannot make the robot blind. Lidars see
    nothing nearer than their least range (0.6 m for the Tugbot, whose front lies within it) or beside their field of
    view.
    """

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        """Prepare for a robot, with nothing remembered.

        Args:
            robot: gives the lidar's geometry and the robot's limits.
            control_period: time between two calls of `update` [s].
        """
        self._robot = robot
        self._period = control_period
        lidar = robot.lidar
        angles = lidar.angles + lidar.mount.yaw
        self._cos, self._sin = np.cos(angles), np.sin(angles)
        self._points = np.empty((CAPACITY + BUMP_POINTS + lidar.num_beams, 2))
        self._num_remembered = 0
        self._num_points = 0

    def update(self, scan: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Take in an observation and return the obstacles now.

        Args:
            scan: `observation["scan"]`, shape (num_beams,), float32.
            motion: `observation["motion"]`, shape (6,), float32.

        Returns:
            Shape (n, 2), float64, base frame [m]; valid until the next call.
        """
        robot, lidar = self._robot, self._robot.lidar
        distance, dtheta = motion[0] * robot.max_v * self._period, motion[1] * robot.max_w * self._period
        kept = remember(
            self._points,
            self._num_remembered,
            self._num_points,
            distance * math.cos(0.5 * dtheta),
            distance * math.sin(0.5 * dtheta),
            dtheta,
            (lidar.mount.x, lidar.mount.y, lidar.mount.yaw),
            # A full turn has no directions beside its view; a beam's width keeps rounding from making one.
            0.5 * lidar.fov + lidar.angle_increment,
            lidar.range_min,
            2.0 * robot.radius + 0.3,
        )
        if motion[4] > 0.5:
            kept = self._add_bump(kept, forward=motion[2] >= 0.0)
        self._num_remembered = kept
        points = self._points[kept:]
        kept += scan_points(scan, lidar.range_max, self._cos, self._sin, lidar.mount.x, lidar.mount.y, points)
        self._num_points = kept
        return self._points[:kept]

    def _add_bump(self, count: int, forward: bool) -> int:
        """Remember that the footprint touched something on the side to which it was driving."""
        bearings = np.linspace(-0.5, 0.5, BUMP_POINTS) + (0.0 if forward else math.pi)
        ring = 0.98 * self._robot.radius * np.column_stack([np.cos(bearings), np.sin(bearings)])
        self._points[count : count + BUMP_POINTS] = ring
        return count + BUMP_POINTS


@njit(cache=True, error_model="numpy")
def free_distance(points, curvature, radius, distance):
    """Tell how far the robot gets along an arc before its footprint touches a point.

    A point that lies within the footprint already (noise, a corner that sticks out of the circle) stops only what
    brings it nearer.

    Args:
        points: shape (n, 2), float64, obstacles in the base frame [m].
        curvature: of the arc, positive to the left [1/m].
        radius: of the footprint [m].
        distance: how far to look along the arc, negative backwards [m].

    Returns:
        The free length of the arc [m], at most `abs(distance)`.
    """
    num_steps = int(abs(distance) / SIGHT_STEP) + 1
    nearest = np.inf
    for k in range(points.shape[0]):
        nearest = min(nearest, points[k, 0] ** 2 + points[k, 1] ** 2)
    # The arc is no shorter than the straight way: up to here the footprint cannot reach the nearest point.
    clear = math.sqrt(nearest) - radius
    for step in range(1, num_steps + 1):
        along = abs(distance) * step / num_steps
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


@njit(cache=True, error_model="numpy")
def mark_missing(data, cells, reach, occupied_from):
    """Mark obstacles in a map that knows of none near them.

    Args:
        data: shape (height, width), int8, occupancy.
        cells: shape (n, 2), int64, (row, column) of obstacles, also outside the map.
        reach: distance up to which an occupied cell accounts for an obstacle [cells].
        occupied_from: least occupancy that is an obstacle [percent].

    Returns:
        A copy with 100 in the cells of those that no occupied cell accounts for.
    """
    height, width = data.shape
    marked = data.copy()
    for k in range(cells.shape[0]):
        row, col = cells[k]
        if row < 0 or col < 0 or row >= height or col >= width:
            continue
        around = data[max(row - reach, 0) : row + reach + 1, max(col - reach, 0) : col + reach + 1]
        if not (around >= occupied_from).any():
            marked[row, col] = 100
    return marked
