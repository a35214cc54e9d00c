"""Joint alignment of the scans of a whole drive to the walls that they have in common."""

import numpy as np

from lidarnaut.envs.estimation.scan_points import ScanGeometry, scan_ends
from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.robots import LidarParams

CELLS = 0.5, 0.25
"""Sides of the cells in the first and in the second half of the iterations; each cell has one line [m]."""
MIN_POINTS = 20
"""Minimum number of scan points in a cell with a line."""
MAX_OFFSET = 3.0
"""Maximum distance of a scan point from its line, in standard deviations of the points in the cell."""
MAX_ROUGHNESS = 0.3
"""Maximum ratio of the standard deviations of points across and along a line."""
NUM_STEPS, SHIFT = 12, 0.382
"""Number of Gauss-Newton steps, and shift of the cells from one step to the next, as a fraction of their side. Walls on
borders then vary."""
PRIOR_STD = np.array([0.05, 0.05, 0.02])
"""Assumed standard deviation of the poses before [m, m, rad]; fixes directions without walls."""


def align_scans(ranges: np.ndarray, poses: np.ndarray, lidar: LidarParams) -> np.ndarray:
    """Refine the base poses of scans, shape (n, 3) [m, m, rad]; the first pose is kept.

    All scan points together form lines in square cells, and Gauss-Newton steps minimise the distances of each scan's
    points from these lines (normal distributions transform, Biber and Strasser, 2003, with point-to-line distances).
    The errors of the poses before must be small compared to `CELLS`.

    Args:
        ranges: scans, shape (n, num_beams), float32 [m].
        poses: base poses before, shape (n, 3), float64, map frame [m, m, rad].
        lidar: beam geometry.
    """
    geometry, is_hit = ScanGeometry.of(lidar), (ranges > 0.0) & (ranges < lidar.range_max)
    scan, points = np.nonzero(is_hit)[0], np.array([scan_ends(row, geometry) for row in ranges])[is_hit].T
    aligned = poses.astype(np.float64)
    for k in range(NUM_STEPS):
        c, s = np.cos(aligned[scan, 2]), np.sin(aligned[scan, 2])
        turned = np.array([c * points[0] - s * points[1], s * points[0] + c * points[1]])
        cell = CELLS[2 * k // NUM_STEPS]
        normals, offsets, weights = _lines((turned + aligned[scan, :2].T) / cell + k * SHIFT, cell)
        slopes = np.array([*normals, normals[1] * turned[0] - normals[0] * turned[1]])
        hessian, right = np.zeros((len(poses), 3, 3)), np.zeros((len(poses), 3))
        for i in range(3):
            right[:, i] = np.bincount(scan, -weights * slopes[i] * offsets, len(poses))
            for j in range(3):
                hessian[:, i, j] = np.bincount(scan, weights * slopes[i] * slopes[j], len(poses))
        right += (poses - aligned) / PRIOR_STD**2
        aligned += np.linalg.solve(hessian + np.diag(PRIOR_STD**-2.0), right[..., None])[..., 0]
    # Return to the frame of the first pose.
    turn = poses[0, 2] - aligned[0, 2]
    c, s = np.cos(turn), np.sin(turn)
    aligned[:, :2] = (aligned[:, :2] - aligned[0, :2]) @ np.array([[c, s], [-s, c]]) + poses[0, :2]
    aligned[:, 2] = wrap_angle(aligned[:, 2] + turn)
    return aligned


def _lines(points: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    cells = np.floor(points).astype(np.int64)
    _, cell, count = np.unique((cells[0] << 32) + cells[1], return_inverse=True, return_counts=True)
    x, y = side * (points - np.array([np.bincount(cell, row) / count for row in points])[:, cell])
    xx, xy, yy = (np.bincount(cell, product) / count for product in (x * x, x * y, y * y))
    across = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    normals = np.array([np.cos(angle), np.sin(angle)])[:, cell]
    offsets = normals[0] * x + normals[1] * y
    is_line = (count >= MIN_POINTS) & (across < MAX_ROUGHNESS**2 * (xx + yy - across))
    variance = np.maximum(across, 1e-6)
    weights = np.where(is_line, 1.0 / variance, 0.0)[cell]
    weights[offsets**2 > MAX_OFFSET**2 * variance[cell]] = 0.0
    return normals, offsets, weights
