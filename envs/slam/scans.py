import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, Window
from lidarnaut.envs.robots import LidarParams

SIDE_START = (1 << 31) - 1
MAX_NEIGHBOURS = 15
"""Maximum number of beams on each side of a beam in a median filter."""


def check_scan(ranges: np.ndarray, motion: Pose2D, lidar: LidarParams) -> np.ndarray:
    """Validate a scan and an odometry motion; return the ranges as float32.

    Raises:
        ValueError: if the number of beams is wrong, or `motion` is not finite.
    """
    ranges = np.asarray(ranges, dtype=np.float32)
    if ranges.shape != (lidar.num_beams,):
        raise ValueError(f"ranges must have shape ({lidar.num_beams},), one per beam of the lidar, got {ranges.shape}")
    if not math.isfinite(motion[0] + motion[1] + motion[2]):
        raise ValueError(f"motion must be finite, got {tuple(motion)}")
    return ranges


@njit(cache=True, error_model="numpy")
def median_ranges(ranges, increment, width):
    """Return a scan with each range replaced by the median over the neighbouring beams within a width [m].

    `ranges`: shape (num_beams,), float32 [m]; +inf (no return) and NaN stay. `increment`: angle between neighbouring
    beams [rad].
    """
    out, last = ranges.copy(), ranges.shape[0] - 1
    for k in range(last + 1):
        if 0.0 < ranges[k] < math.inf:
            half = min(int(0.5 * width / (ranges[k] * increment)), MAX_NEIGHBOURS, k, last - k)
            out[k] = np.nanmedian(ranges[k - half : k + half + 1])
    return out


@njit(cache=True, error_model="numpy")
def beam_ends(ranges, pose, geometry, corner, ends):
    """Compute beam endpoints in a map; return lidar position (x, y) [cells] and extent of the scan.

    `ranges`: shape (num_beams,), float32 [m], NaN for ignored beams. `pose`: base pose, map frame [m, m, rad].
    `corner`: column and row of the map's first cell from the map frame's origin. `ends` receives x, y [cells] and
    return flag, shape (num_beams, 3), float64. The extent is (col_min, row_min, col_max, row_max).
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
    """Return the rectangle of map cells around all beams of scans at base poses, shape (n, 3) [m, m, rad].

    `ranges`: shape (n, num_beams), or (1, num_beams) for one scan at all poses. Other arguments as in `beam_ends`.
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
    """Prepare line tracing through grid cells (as Bresenham, 1965), in integer arithmetic.

    Returns the number of steps, the slope times 2^32, and the changes of the flat cell index per step along and across
    the main axis.
    """
    row_step, col_step = (width if d_row > 0 else -width), (1 if d_col > 0 else -1)
    d_row, d_col = abs(d_row), abs(d_col)
    if d_col >= d_row:
        return d_col, (d_row << 32) // max(d_col, 1), col_step, row_step
    return d_row, (d_col << 32) // d_row, row_step, col_step
