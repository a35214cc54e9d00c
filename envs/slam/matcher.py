"""The Monte Carlo scan matcher."""

import math

import numpy as np
from numba import njit

from envs.geometry.lookup import load

from .cells import COUNT_BITS, ONE


@njit(cache=True, error_model="numpy")
def project_hits(ranges, range_max, directions, mount_x, mount_y, resolution, points):
    """Find where the beams of a scan end, seen from the robot's base.

    Args:
        ranges: shape (num_beams,), float32 [m]; hits are those between 0 and `range_max`.
        range_max: the lidar's range [m].
        directions: shape (2, num_beams), float64, cosine and sine of the beams in the base frame.
        mount_x: where the lidar sits in the base frame [m].
        mount_y: where the lidar sits in the base frame [m].
        resolution: side of a cell [m].
        points: shape (2, num_beams), float32, written: x and y of the hits [cells].

    Returns:
        Number of hits.
    """
    count = 0
    for k in range(ranges.shape[0]):
        r = ranges[k]
        if r > 0.0 and r < range_max:
            x = (mount_x + r * directions[0, k]) / resolution
            y = (mount_y + r * directions[1, k]) / resolution
            points[0, count] = x
            points[1, count] = y
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def score(words, points, num_points, unvisited, x, y, theta, indices):
    """Return the sum of the occupancies of the cells in which a scan's hits fall, fixed-point.

    The original's cost is the number of hits minus this sum; the best pose is the same. Outside the map nothing was
    ever observed.

    Args:
        words: shape (height, width), int32, the map.
        points: shape (2, >= num_points), float32, the hits in the base frame [cells].
        num_points: number of hits.
        unvisited: word of a cell never observed.
        x: position of the base from the map's corner [cells].
        y: position of the base from the map's corner [cells].
        theta: heading of the base [rad].
        indices: shape (>= num_points,), uint32: room to work in.
    """
    x32, y32 = np.float32(x), np.float32(y)
    c, s = np.float32(math.cos(theta)), np.float32(math.sin(theta))
    rows, cols, width = np.float32(words.shape[0]), np.float32(words.shape[1]), np.int32(words.shape[1])
    lowest = np.uint32(0xFFFFFFFF)
    for k in range(num_points):
        col = c * points[0, k] - s * points[1, k] + x32
        row = s * points[0, k] + c * points[1, k] + y32
        inside = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
        # Outside is 0, which a hit in the map's corner is as well: the loop below tells them apart.
        index = np.uint32(np.int32(row) * width + np.int32(col) if inside else 0)
        indices[k] = index
        lowest = min(lowest, index)
    flat = words.ravel()
    total = 0
    for k in range(num_points):
        total += load(flat, indices[k]) >> COUNT_BITS
    if lowest == 0:
        for k in range(num_points):
            if indices[k] == 0:
                col = c * points[0, k] - s * points[1, k] + x32
                row = s * points[0, k] + c * points[1, k] + y32
                if col < 0 or row < 0 or col >= cols or row >= rows:
                    total += (unvisited >> COUNT_BITS) - (flat[0] >> COUNT_BITS)
    return total


@njit(cache=True, error_model="numpy")
def _note(row, x, y, theta, cost, accepted):
    """Write a pose that was tested to a row of the record. Assigning a tuple takes seconds longer to compile."""
    row[0], row[1], row[2], row[3], row[4] = x, y, theta, cost, 1.0 if accepted else 0.0


@njit(cache=True, error_model="numpy")
def match(
    words,
    points,
    num_points,
    unvisited,
    x,
    y,
    theta,
    sigma_xy,
    sigma_theta,
    max_failed,
    max_tries,
    noise,
    record,
):
    """Search the pose at which a scan fits the map best.

    Candidates are drawn around the best pose so far. An improvement that comes after more than a third of the allowed
    failures halves the spread and forgives the failures. Poses are (x, y) in cells from the map's corner, theta.

    Args:
        words: shape (height, width), int32, the map.
        points: shape (2, >= num_points), float32, the hits in the base frame [cells].
        num_points: number of hits.
        unvisited: word of a cell never observed.
        x: predicted position [cells].
        y: predicted position [cells].
        theta: predicted heading [rad].
        sigma_xy: spread of positions [cells].
        sigma_theta: spread of headings [rad].
        max_failed: failures that end the search.
        max_tries: candidates that end the search.
        noise: shape (max_tries, 3), float64, standard normal.
        record: shape (0, 5), or (max_tries + 1, 5), float64, written: x, y, theta, cost and whether accepted of every
            pose tested, the predicted one first.

    Returns:
        x, y, theta of the best pose, its cost (number of hits minus the sum of occupancies), candidates accepted,
        candidates tried.
    """
    indices = np.empty(points.shape[1], dtype=np.uint32)
    best = score(words, points, num_points, unvisited, x, y, theta, indices)
    if record.shape[0] > 0:
        _note(record[0], x, y, theta, num_points - best / ONE, True)
    failed = 0
    tries = 0
    accepted = 0
    while failed < max_failed and tries < max_tries:
        new_x = x + sigma_xy * noise[tries, 0]
        new_y = y + sigma_xy * noise[tries, 1]
        new_theta = theta + sigma_theta * noise[tries, 2]
        value = score(words, points, num_points, unvisited, new_x, new_y, new_theta, indices)
        tries += 1
        improved = value > best
        if record.shape[0] > 0:
            _note(record[tries], new_x, new_y, new_theta, num_points - value / ONE, improved)
        if not improved:
            failed += 1
            continue
        best, x, y, theta = value, new_x, new_y, new_theta
        accepted += 1
        if failed > max_failed // 3:
            sigma_xy *= 0.5
            sigma_theta *= 0.5
            failed = 0
    return x, y, theta, num_points - best / ONE, accepted, tries
