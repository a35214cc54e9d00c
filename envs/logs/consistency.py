"""Consistency of a trajectory with the scans of a log."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry.lines import next_cell, start_walk
from lidarnaut.envs.slam import HectorParams
from lidarnaut.envs.slam.log_odds_map import LogOddsMap

from .log import Log

END_MARGIN = 0.3
"""Occupied cells within this distance of a beam's end are no conflict [m], for thick walls and grazing beams."""
MAX_CONFLICTS = 0.2
"""Maximum share of beams through occupied cells in a consistent map. Intel Research Lab: 0.06 to 0.16 if SLAM succeeds,
else 0.24 to 0.53."""
CHUNK = 256


def conflict_share(log: Log, poses: np.ndarray) -> float:
    """Return the share of beams that pass through cells occupied in other scans, from 0 to 1.

    All scans are integrated into a new map. The share rises if rooms overlap, but not if the trajectory is bent without
    overlap. `poses`: base poses at the scans, shape (m, 3), float64 [m, m, rad]. NaN if no beam has a return or a pose
    is not finite.
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
    height, width = occupancy.shape
    conflicts = count = 0
    for i in range(ranges.shape[0]):
        x, y, theta = sensors[i, 0], sensors[i, 1], sensors[i, 2]
        for k in range(ranges.shape[1]):
            if not ranges[i, k] <= range_max:
                continue
            count += 1
            length = (ranges[i, k] - END_MARGIN) / resolution
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
