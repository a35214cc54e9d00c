"""Scans as another lidar, or one that does not move during the scan, would measure them."""

import math
from collections.abc import Sequence

import numpy as np

from .pose import between_poses

SAME_POSITION = 1e-3
"""Smaller differences between lidar positions are ignored [m]."""
SAME_SURFACE = 0.1
"""Maximum range difference of adjacent beams on one surface [share of the shorter range]."""
MOVING_REACH = 1.5
"""Angle between beams of a moving lidar that is filled, in units of their greatest increment: walls come nearer."""


def resample_scan(
    ranges: np.ndarray,
    angles: np.ndarray,
    position: Sequence[float],
    target: Sequence[float],
    beams: tuple[float, float, int],
    poses: np.ndarray | None = None,
) -> np.ndarray:
    """Return a scan as a lidar at `target` would measure it at one instant, shape (num_beams,), float32 [m].

    Ranges are interpolated between adjacent beams on one surface, else nearest; NaN outside of the field of view. With
    `poses`, the motion during the scan is corrected (deskewing), as in Cartographer (Hess et al., 2016).

    Args:
        ranges: shape (n,) [m]; +inf for no return, NaN or 0 for an invalid beam.
        angles: directions of the beams in the base frame, shape (n,) [rad].
        position: lidar (x, y) in the base frame [m].
        target: lidar (x, y) of the result in the base frame [m].
        beams: first angle and angle increment in the base frame [rad], and number of beams of the result.
        poses: base pose of the result, and that of each beam or of all beams, in any fixed frame, shape (1 + n, 3) or
            (2, 3) [m, m, rad]; None without motion.
    """
    low, step, num_beams = beams
    ranges, (dx, dy) = ranges.astype(np.float64), np.subtract(position, target)[:, None]
    if poses is not None:
        x, y, turn = between_poses(poses[:1], poses[1:]).T
        dx = x + np.cos(turn) * position[0] - np.sin(turn) * position[1] - target[0]
        dy = y + np.sin(turn) * position[0] + np.cos(turn) * position[1] - target[1]
        angles = angles + turn
    own_step = np.abs(np.diff(angles)).max(initial=0.0) * (1.0 if poses is None or len(poses) == 2 else MOVING_REACH)
    if np.hypot(dx, dy).max() > SAME_POSITION:
        hit = np.isfinite(ranges) & (ranges > 0.0)
        x, y = (np.broadcast_to(each, len(ranges))[hit] for each in (dx, dy))
        x, y = x + ranges[hit] * np.cos(angles[hit]), y + ranges[hit] * np.sin(angles[hit])
        angles, ranges[hit] = angles.copy(), np.hypot(x, y)
        angles[hit] = np.arctan2(y, x)
    angles = (angles - low) % (2.0 * math.pi)
    order = np.argsort(angles, kind="stable")
    angles, ranges = angles[order], ranges[order]
    # Every beam needs two neighbors.
    angles = np.concatenate([angles[-1:] - 2.0 * math.pi, angles, angles[:1] + 2.0 * math.pi])
    ranges = np.concatenate([ranges[-1:], ranges, ranges[:1]])
    wanted = step * np.arange(num_beams)
    right = np.clip(np.searchsorted(angles, wanted), 1, len(angles) - 1)
    left = right - 1
    gap = angles[right] - angles[left]
    share = (wanted - angles[left]) / np.maximum(gap, 1e-12)
    nearest = np.where(share < 0.5, left, right)
    with np.errstate(invalid="ignore"):
        one = np.abs(ranges[right] - ranges[left]) <= SAME_SURFACE * np.minimum(ranges[left], ranges[right])
        between = (1.0 - share) * ranges[left] + share * ranges[right]
    reach = min(max(own_step, step), 2.0 * step)  # no widening of coarse beams
    result = np.where(one & (gap < 1.5 * reach) & np.isfinite(between), between, ranges[nearest])
    result[np.abs(wanted - angles[nearest]) > 0.51 * reach] = np.nan
    return result.astype(np.float32)
