"""Scans as SLAM and localization take them: checked, and as the points where their beams end."""

import math
from typing import NamedTuple, Self

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D, Window
from lidarnaut.envs.robots import LidarParams

SIDE_START = (1 << 31) - 1
"""Half a cell, less a grain, with 32 fractional bits: a line right between two cells takes the nearer to its start."""


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
    skip_exceeding: bool = False
    """Whether beams without a return are ignored where a scan is integrated; else they clear up to the range."""

    @classmethod
    def of(cls, lidar: LidarParams, resolution: float, skip_exceeding: bool = False) -> Self:
        """Return the geometry of all beams of a lidar."""
        mount = float(lidar.mount.x), float(lidar.mount.y)
        return cls(lidar.directions, *mount, float(lidar.range_max), float(resolution), skip_exceeding)


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
def beam_ends(ranges, pose, geometry, corner, ends):
    """Find where the beams of a scan end in a map.

    `ranges`: shape (num_beams,), float32 [m], NaN for a beam to ignore; `pose`: x, y, heading of the base, map frame
    [m, m, rad]; `geometry`: `ScanGeometry`, a beam without a return clears up to the lidar's range, or is ignored;
    `corner`: column and row of the map's first cell, counted from the map frame's origin; `ends`: shape (num_beams, 3),
    float64, written: x, y [cells], and 1 for a hit, else 0; NaN for beams to ignore. Returns the position of the lidar
    from the map's corner (x, y) [cells], and smallest and greatest column and row that the scan touches: col_min,
    row_min, col_max, row_max.
    """
    directions, range_max, resolution = geometry.directions, geometry.range_max, geometry.resolution
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = (pose[0] + c * geometry.mount_x - s * geometry.mount_y) / resolution - corner[0]
    y = (pose[1] + s * geometry.mount_x + c * geometry.mount_y) / resolution - corner[1]
    x_min = x_max = x
    y_min = y_max = y
    for k in range(ranges.shape[0]):
        r = float(ranges[k])
        hit = r < range_max
        if not r > 0.0 or (geometry.skip_exceeding and not hit):
            ends[k, 0] = np.nan
            continue
        r = min(r, range_max) / resolution
        end_x = x + r * (c * directions[0, k] - s * directions[1, k])
        end_y = y + r * (s * directions[0, k] + c * directions[1, k])
        ends[k, 0], ends[k, 1], ends[k, 2] = end_x, end_y, 1.0 if hit else 0.0
        x_min, x_max = min(x_min, end_x), max(x_max, end_x)
        y_min, y_max = min(y_min, end_y), max(y_max, end_y)
    return (x, y), (math.floor(x_min), math.floor(y_min), math.floor(x_max), math.floor(y_max))


@njit(cache=True, error_model="numpy")
def scans_window(ranges, poses, geometry, corner, ends):
    """Return the `Window` of the cells that scans touch; see `beam_ends`.

    Ranges have shape (n, num_beams), or (1, num_beams) for one scan at all poses, which have shape (n, 3).
    """
    col_min = row_min = 1 << 40
    col_max = row_max = -(1 << 40)
    for i in range(poses.shape[0]):
        extent = beam_ends(ranges[min(i, ranges.shape[0] - 1)], poses[i], geometry, corner, ends)[1]
        col_min, row_min = min(col_min, extent[0]), min(row_min, extent[1])
        col_max, row_max = max(col_max, extent[2]), max(row_max, extent[3])
    return Window(row_min, col_min, row_max - row_min + 1, col_max - col_min + 1)


@njit(cache=True, error_model="numpy")
def walk(d_row, d_col, width):
    """Return how to walk over so many rows and columns, in a straight line through a flattened map.

    Number of steps; what each adds to the sideways position, with 32 fractional bits; what a step forward and what one
    sideways add to the index.
    """
    row_step, col_step = (width if d_row > 0 else -width), (1 if d_col > 0 else -1)
    d_row, d_col = abs(d_row), abs(d_col)
    if d_col >= d_row:
        return d_col, (d_row << 32) // max(d_col, 1), col_step, row_step
    return d_row, (d_col << 32) // d_row, row_step, col_step
