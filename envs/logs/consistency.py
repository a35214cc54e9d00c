"""Whether the scans of a log agree with each other at the poses of a trajectory."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry.lines import next_cell, start_walk
from lidarnaut.envs.slam import HectorParams
from lidarnaut.envs.slam.log_odds_map import LogOddsMap

from .log import Log

MARGIN = 0.3
"""A beam may pass through occupied cells this near to its end [m]: walls have widths, and grazing beams touch them."""
MAX_CONFLICTS = 0.2
"""Share of conflicting beams above which a map does not fit. In the Intel Research Lab it is 0.06 to 0.16 where a SLAM
succeeds, and 0.24 to 0.53 by odometry alone or where a SLAM fails (docs/notes/slam.md, "Sparse logs")."""
CHUNK = 256
"""Scans that are integrated at once."""


def conflict_share(log: Log, poses: np.ndarray) -> float:
    """Return the share of beams that pass through what other scans show as occupied, from 0 to 1.

    All scans are integrated at their poses into a map of their own, so that SLAMs with maps of different kinds can be
    compared. A trajectory whose parts contradict each other, such as rooms that are laid over each other, shows here
    without ground truth; one that is bent, but meets none of its own walls, does not.

    `poses` are those of the base at its scans, shape (m, 3), float64 [m, m, rad]. The share is that among beams with a
    return; NaN if there are none, if a pose is not finite, or if poses are too far apart for a map.
    """
    if not np.isfinite(poses).all():
        return math.nan
    map = LogOddsMap(HectorParams(num_levels=1, skip_exceeding=True), log.lidar)
    try:
        for first in range(0, len(poses), CHUNK):
            map.integrate_all(log.ranges[first : first + CHUNK], poses[first : first + CHUNK])
    except MemoryError:
        return math.nan
    mount, grid = log.lidar.mount, map.grid
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * mount.x - s * mount.y - grid.origin[0]
    y = poses[:, 1] + s * mount.x + c * mount.y - grid.origin[1]
    sensors = np.stack([x / grid.resolution, y / grid.resolution, poses[:, 2] + mount.yaw], axis=1)
    over = (log.ranges, log.lidar.angles, sensors, grid.resolution)
    conflicts, count = _count_conflicts(grid.data, *over, log.lidar.range_max)
    return conflicts / count if count else math.nan


@njit(cache=True, error_model="numpy")
def _count_conflicts(occupancy, ranges, angles, sensors, resolution, range_max):
    """Return how many beams pass through occupied cells, and how many have a return; `sensors` [cells, cells, rad]."""
    height, width = occupancy.shape
    conflicts = count = 0
    for i in range(ranges.shape[0]):
        x, y, theta = sensors[i, 0], sensors[i, 1], sensors[i, 2]
        for k in range(ranges.shape[1]):
            if not ranges[i, k] <= range_max:
                continue
            count += 1
            length = (ranges[i, k] - MARGIN) / resolution
            if length <= 0.0:
                continue
            angle = theta + angles[k]
            walk = start_walk(x, y, x + length * math.cos(angle), y + length * math.sin(angle))
            while walk.rows_left + walk.cols_left > 0:
                walk = next_cell(walk)
                is_inside = 0 <= walk.row < height and 0 <= walk.col < width
                if is_inside and occupancy[walk.row, walk.col] >= 50:
                    conflicts += 1
                    break
    return conflicts, count
