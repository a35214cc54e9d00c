"""Scan matching to normal distributions (Biber and Straßer, "The normal distributions transform", 2003).

A square of map cells stores number, sums and products of all scan points in it, as a normal distribution of the wall's
position. Distributions locate walls more precisely than the side of a cell, so that headings drift less.
"""

import math

from lidarnaut.envs.compilation import njit

from .gauss_newton import Fit, solve

SIDE = 4
"""Side of a square with one normal distribution [cells]."""
NUM_SUMS = 6
"""Number of points in a square, and sums of x, y, xx, xy and yy from its centre [cells, cells^2]."""
MIN_POINTS = 4
"""Minimum number of points in a square for matching."""
MIN_SHARE = 0.2
"""Minimum share of the scan points in known cells that must match distributions; otherwise the pose is kept."""
POINT_VARIANCE = 0.04
"""Variance added to distributions [cells^2], 1 cm for cells of 5 cm: lidar noise, and pose errors of earlier scans."""
MAX_SQUARED_DISTANCE = 9.0
"""Squared Mahalanobis distance above which scan points are ignored."""
CORRELATION = 3.0
"""Factor on the variance of scan points, because errors of neighbouring points are correlated."""
STEPS = 2
"""Number of Gauss-Newton steps."""


@njit(cache=True, error_model="numpy")
def add_points(sums, ends):
    """Add the beam endpoints of a scan to normal distributions.

    `sums`: shape (height / SIDE, width / SIDE, NUM_SUMS), float32. `ends`: x, y [cells from the map's corner] and
    return flag, shape (num_beams, 3), float64, from `beam_ends`.
    """
    for k in range(ends.shape[0]):
        if math.isnan(ends[k, 0]) or not ends[k, 2] > 0.0:
            continue
        col, row = int(ends[k, 0] / SIDE), int(ends[k, 1] / SIDE)
        x, y = ends[k, 0] - SIDE * (col + 0.5), ends[k, 1] - SIDE * (row + 0.5)
        sums[row, col, 0] += 1.0
        sums[row, col, 1] += x
        sums[row, col, 2] += y
        sums[row, col, 3] += x * x
        sums[row, col, 4] += x * y
        sums[row, col, 5] += y * y


@njit(cache=True, error_model="numpy")
def evaluate(sums, points, num_points, x, y, theta, scale):
    """Return Hessian and right-hand side of a Gauss-Newton step, times `scale`, and as `total` the matched points.

    Points may slide along walls: the inverse of the largest eigenvalue of the covariance is subtracted from the
    information. Weights (1 - d^2 / MAX_SQUARED_DISTANCE)^2 reduce the influence of points at distance d (Beaton and
    Tukey, 1974). `points`: shape (2, >= num_points), float32, base frame [cells]. `x`, `y`: from the map's corner
    [cells]; `theta` [rad].
    """
    height, width = sums.shape[0], sums.shape[1]
    c, s = math.cos(theta), math.sin(theta)
    h_xx = h_xy = h_xt = h_yy = h_yt = h_tt = b_x = b_y = b_t = num_matched = 0.0
    for k in range(num_points):
        r_x, r_y = c * points[0, k] - s * points[1, k], s * points[0, k] + c * points[1, k]
        u, v = (r_x + x) / SIDE, (r_y + y) / SIDE
        if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
            continue
        square = sums[int(v), int(u)]
        if square[0] < MIN_POINTS:
            continue
        share = 1.0 / square[0]
        mean_x, mean_y = share * square[1], share * square[2]
        xx = share * square[3] - mean_x * mean_x + POINT_VARIANCE
        xy = share * square[4] - mean_x * mean_y
        yy = share * square[5] - mean_y * mean_y + POINT_VARIANCE
        d_x, d_y = SIDE * (u - int(u) - 0.5) - mean_x, SIDE * (v - int(v) - 0.5) - mean_y
        inverse = 1.0 / (xx * yy - xy * xy)
        along = 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        xx, xy, yy = inverse * yy - 1.0 / along, -inverse * xy, inverse * xx - 1.0 / along
        g_x, g_y = xx * d_x + xy * d_y, xy * d_x + yy * d_y
        weight = 1.0 - (d_x * g_x + d_y * g_y) / MAX_SQUARED_DISTANCE
        if weight <= 0.0:
            continue
        num_matched += 1.0
        weight *= scale * weight
        xt, yt = r_x * xy - r_y * xx, r_x * yy - r_y * xy
        h_xx += weight * xx
        h_xy += weight * xy
        h_yy += weight * yy
        h_xt += weight * xt
        h_yt += weight * yt
        h_tt += weight * (r_x * yt - r_y * xt)
        b_x -= weight * g_x
        b_y -= weight * g_y
        b_t -= weight * (r_x * g_y - r_y * g_x)
    return Fit(h_xx, h_xy, h_xt, h_yy, h_yt, h_tt, b_x, b_y, b_t, num_matched, 0.0)


@njit(cache=True, error_model="numpy")
def refine_to_distributions(sums, points, num_points, num_known, pose, prior, residual_variance):
    """Refine a pose (x, y from the map's corner [cells], heading [rad]) by Gauss-Newton steps to the distributions.

    `num_known`: number of points in known cells. `prior`: its weights are multiplied by `residual_variance`. Other
    arguments as in `evaluate`.
    """
    x, y, theta = pose
    for _ in range(STEPS):
        fit = evaluate(sums, points, num_points, x, y, theta, residual_variance / CORRELATION)
        if fit.total < MIN_SHARE * num_known:
            return pose
        dx, dy, turn = solve(fit, prior, x, y, theta)
        x, y, theta = x + dx, y + dy, theta + turn
    return x, y, theta
