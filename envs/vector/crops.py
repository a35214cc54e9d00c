"""Observations of many robots at once. Kernels."""

from numba import njit

from envs.estimation.map_pyramid import crop_level
from envs.observations.scan import scale_scan


@njit(cache=True, error_model="numpy")
def scale_scans(ranges, range_max, active, out):
    """Write the scans of active robots over the greatest range; shapes (n, 1, num_beams) and (n, num_beams)."""
    for i in range(active.shape[0]):
        if active[i]:
            scale_scan(ranges[i, 0], range_max, out[i])


@njit(cache=True, error_model="numpy")
def crop_levels(levels, sizes, pose, origin, side, pixel, active, out):
    """Crop the maps around active robots; see `crop_level`. `sizes`: shape (n, 2), rows and columns of the levels."""
    for i in range(active.shape[0]):
        if active[i]:
            x, y = (pose[i, 0] - origin[i, 0]) / side, (pose[i, 1] - origin[i, 1]) / side
            crop_level(levels[i], sizes[i, 0], sizes[i, 1], x, y, pose[i, 2], pixel / side, out[i])
