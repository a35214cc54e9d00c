"""Scans as SLAM and localization take them: checked, and as the points where their beams end."""

import math
from typing import NamedTuple, Self

import numpy as np
from numba import njit

from envs.geometry import Pose2D
from envs.robots import LidarParams


class ScanGeometry(NamedTuple):
    """How the beams of a lidar lie over a map."""

    directions: np.ndarray
    """Shape (2, num_beams), float64, cosine and sine of the beams in the base frame."""
    mount_x: float
    """Position of the lidar in the base frame, with `mount_y` [m]."""
    mount_y: float
    range_max: float
    """Readings from this on are no return [m]."""
    resolution: float
    """Side of a map cell [m]."""

    @classmethod
    def of(cls, lidar: LidarParams, resolution: float) -> Self:
        """Return the geometry of all beams of a lidar."""
        return cls(
            lidar.directions, float(lidar.mount.x), float(lidar.mount.y), float(lidar.range_max), float(resolution)
        )


def check_scan(ranges: np.ndarray, motion: Pose2D, lidar: LidarParams) -> np.ndarray:
    """Return `ranges` as float32.

    Raises:
        ValueError: if the scan has another number of beams than the lidar, or the motion is not finite.
    """
    ranges = np.asarray(ranges, dtype=np.float32)
    if ranges.shape != (lidar.num_beams,):
        raise ValueError(f"ranges must have shape ({lidar.num_beams},), as the lidar has beams, got {ranges.shape}")
    if not math.isfinite(motion[0] + motion[1] + motion[2]):
        raise ValueError(f"motion must be finite, got {tuple(motion)}")
    return ranges


@njit(cache=True, error_model="numpy")
def project_hits(ranges, geometry, points):
    """Find where the beams of a scan end, seen from the robot's base.

    Hits are `ranges`, shape (num_beams,), float32 [m], between 0 and that of the lidar; `geometry` is a `ScanGeometry`.
    Writes x and y of the hits to `points`, shape (2, num_beams), float32 [cells], and returns how many there are.
    """
    count = 0
    for k in range(ranges.shape[0]):
        r = ranges[k]
        if r > 0.0 and r < geometry.range_max:
            points[0, count] = (geometry.mount_x + r * geometry.directions[0, k]) / geometry.resolution
            points[1, count] = (geometry.mount_y + r * geometry.directions[1, k]) / geometry.resolution
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def beam_ends(ranges, geometry, skip_exceeding, x, y, c, s, ends):
    """Find where the beams of a scan end in the map.

    Args:
        ranges: shape (num_beams,), float32 [m]; NaN for a beam to ignore.
        geometry: `ScanGeometry`; a beam without a return clears up to the lidar's range.
        skip_exceeding: whether beams without a return are ignored.
        x: position of the lidar [cells].
        y: position of the lidar [cells].
        c: cosine of the base's heading.
        s: sine of the base's heading.
        ends: shape (num_beams, 3), float64, written: x, y [cells], and 1 for a hit, else 0; NaN for beams to ignore.

    Returns:
        Smallest and greatest column and row that the scan touches: col_min, row_min, col_max, row_max.
    """
    directions, range_max = geometry.directions, geometry.range_max
    x_min = x_max = x
    y_min = y_max = y
    for k in range(ranges.shape[0]):
        r = float(ranges[k])
        hit = r < range_max
        if not r > 0.0 or (skip_exceeding and not hit):
            ends[k, 0] = np.nan
            continue
        r = min(r, range_max) / geometry.resolution
        end_x = x + r * (c * directions[0, k] - s * directions[1, k])
        end_y = y + r * (s * directions[0, k] + c * directions[1, k])
        ends[k, 0], ends[k, 1], ends[k, 2] = end_x, end_y, 1.0 if hit else 0.0
        x_min, x_max = min(x_min, end_x), max(x_max, end_x)
        y_min, y_max = min(y_min, end_y), max(y_max, end_y)
    return math.floor(x_min), math.floor(y_min), math.floor(x_max), math.floor(y_max)
