"""Obstacle points of scans and contacts, and collision checks along arcs, base frame."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit

NO_POINTS = np.empty((0, 2))
SIGHT_STEP = 0.02
"""Maximum spacing of collision checks along an arc [m]."""
DUPLICATE_DISTANCE = 0.02
"""Distance below which two remembered points are duplicates [m]."""
MIN_SPEED = 1e-9
"""Lower bound of speeds used as divisors [m/s]."""
MAX_REMEMBERED = 1000
BUMP_POINTS = 5


@njit(cache=True, error_model="numpy")
def remember(points, num_remembered, num_points, motion, numbers):
    """Move obstacle points by the robot's motion; keep only points that the lidar no longer sees.

    The first `num_remembered` of `num_points` were remembered before, the rest are from the last scan. Returns the
    number of kept points, at most `MAX_REMEMBERED`.
    """
    dx, dy, dtheta = motion
    mount = numbers.mount
    c, s = math.cos(dtheta), math.sin(dtheta)
    kept = 0
    for k in range(num_points):
        u, v = points[k, 0] - dx, points[k, 1] - dy
        x, y = c * u + s * v, c * v - s * u
        distance = math.hypot(x - mount[0], y - mount[1])
        is_hidden = distance < numbers.range_min
        if not is_hidden and distance < numbers.range_far:
            bearing = math.atan2(y - mount[1], x - mount[0]) - mount[2]
            is_hidden = abs((bearing + math.pi) % (2.0 * math.pi) - math.pi) > numbers.half_fov
        if not is_hidden or kept == MAX_REMEMBERED:
            continue
        is_new = True
        if k >= num_remembered:
            for other in range(kept):
                if abs(points[other, 0] - x) < DUPLICATE_DISTANCE and abs(points[other, 1] - y) < DUPLICATE_DISTANCE:
                    is_new = False
                    break
        if is_new:
            points[kept, 0], points[kept, 1] = x, y
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def add_bump(points, count, radius, forward):
    """Append points of a bumper contact at the front or rear of the footprint; return the number of points."""
    for k in range(BUMP_POINTS):
        bearing = -0.5 + k / (BUMP_POINTS - 1) + (0.0 if forward else math.pi)
        points[count + k, 0] = 0.98 * radius * math.cos(bearing)
        points[count + k, 1] = 0.98 * radius * math.sin(bearing)
    return count + BUMP_POINTS


@njit(cache=True, error_model="numpy")
def forget_inside(points, num_remembered, num_points, radius):
    """Delete remembered points within the robot's `radius` [m]; return the number of deleted points."""
    kept = 0
    for k in range(num_points):
        if k >= num_remembered or math.hypot(points[k, 0], points[k, 1]) > radius:
            points[kept, 0], points[kept, 1] = points[k, 0], points[k, 1]
            kept += 1
    return num_points - kept


@njit(cache=True, error_model="numpy")
def points_within(points, distance):
    """Return the points within `distance` [m] of the origin, shape (k, 2) [m]."""
    near = np.empty_like(points)
    count = 0
    for k in range(points.shape[0]):
        near[count, 0], near[count, 1] = points[k, 0], points[k, 1]
        count += points[k, 0] ** 2 + points[k, 1] ** 2 <= distance * distance
    return near[:count]


@njit(cache=True, error_model="numpy")
def free_distance(points, curvature, radius, distance):
    """Return the distance along an arc before the footprint touches a point [m], at most `abs(distance)`.

    A point inside the footprint blocks only motion towards it. `points`: obstacles, shape (n, 2), float64, base frame
    [m]. `curvature`: positive to the left [1/m]. `radius`: footprint radius [m]. `distance`: negative for backwards
    [m].
    """
    num_steps = int(abs(distance) / SIGHT_STEP) + 1
    nearest = np.inf
    for k in range(points.shape[0]):
        nearest = min(nearest, points[k, 0] ** 2 + points[k, 1] ** 2)
    # Below this length, the footprint cannot reach the nearest point.
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
            squared = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2
            if squared < radius * radius and math.sqrt(squared) < math.hypot(points[k, 0], points[k, 1]) - 1e-3:
                return abs(distance) * (step - 1) / num_steps
    return abs(distance)


@njit(cache=True, error_model="numpy")
def stoppable_share(points, v, w, radius, braking, period):
    """Return the largest fraction of a twist, at most 1, that allows a stop before a collision.

    The robot drives on for one control period `period` [s], then brakes at `braking` [m/s2]. `points`: obstacles, base
    frame [m]. `radius`: footprint radius [m].
    """
    if v == 0.0:
        return 1.0
    delay = braking * period
    free = free_distance(points, w / v, radius, v * period + 0.5 * v * abs(v) / braking)
    return min(1.0, (math.sqrt(delay**2 + 2.0 * braking * free) - delay) / max(abs(v), MIN_SPEED))
