"""Gauss-Newton scan matching with a pose prior (Kohlbrecher et al., 2011, section IV.B).

Minimises over the pose

    sum over scan points of (1 - M(q))^2  +  (pose - prior)^T W (pose - prior),

with scan points q in the map and interpolated occupancy M, from 0 to 1. The original has no prior. Lengths are in cells
of the finest map.
"""

import math
from functools import singledispatch
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import load

MAX_TURN = 0.2
"""Maximum heading change per Gauss-Newton step [rad]."""
SMALL_STEP = 1e-2
"""Gauss-Newton steps on the finest map end when position and all scan points move by less than this [cells]."""
COARSE_STEP = 0.05


class PosePrior(NamedTuple):
    """Pose prior: x, y [cells] and heading [rad], with entries of the weight matrix W."""

    x: float
    y: float
    theta: float
    w_xx: float
    w_xy: float
    w_xt: float
    w_yy: float
    w_yt: float
    w_tt: float


class Fit(NamedTuple):
    """Sums over the scan points at a pose: Hessian and right-hand side of a Gauss-Newton step, and residuals."""

    h_xx: float
    h_xy: float
    h_xt: float
    h_yy: float
    h_yt: float
    h_tt: float
    b_x: float
    """Right-hand side entry: sum of occupancy gradient times residual."""
    b_y: float
    b_t: float
    total: float
    """Sum of occupancies at the scan points."""
    squares: float
    """Sum of squared residuals, (1 - occupancy)^2."""


class Level(NamedTuple):
    """Flattened occupancy grid at one resolution."""

    occupancy: np.ndarray
    height: int
    width: int


@singledispatch
def at_level(map, level):
    """Return a map at one resolution: flattened `occupancy`, `height` and `width`; level 0 is the finest.

    A map is a tuple of arrays, shape (height, width), int8, finest first, or a named tuple with a registered function.
    """
    return Level(map[level].ravel(), map[level].shape[0], map[level].shape[1])


@singledispatch
def neighbours(view, row, col):
    """Return flat map indices of cells (row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1)."""
    corner = np.uint64(row * view.width + col)
    above = corner + np.uint64(view.width)
    return corner, corner + np.uint64(1), above, above + np.uint64(1)


# Compiled functions dispatch by the class of a named tuple, like Python.
@overload(at_level, inline="always")
def _at_level(map, level):
    return at_level.dispatch(getattr(map, "instance_class", tuple))


@overload(neighbours, inline="always")
def _neighbours(view, row, col):
    return neighbours.dispatch(view.instance_class)


@njit(cache=True, error_model="numpy")
def evaluate(map, level, points, num_points, x, y, theta):
    """Evaluate the fit of a scan at a pose: Hessian, right-hand side and residuals of Gauss-Newton scan matching.

    `x`, `y`: from the map's corner [cells]; `theta` [rad]. Cell sides double per map `level`; unknown cells count as
    0.5. `points`: scan points, shape (2, >= num_points), float32, base frame [cells].
    """
    view, scale = at_level(map, level), 0.5**level
    flat, height, width = view.occupancy, view.height, view.width
    c, s = math.cos(theta), math.sin(theta)
    h_xx = h_xy = h_xt = h_yy = h_yt = h_tt = b_x = b_y = b_t = total = squares = 0.0
    for k in range(num_points):
        p_x, p_y = float(points[0, k]), float(points[1, k])
        r_x, r_y = c * p_x - s * p_y, s * p_x + c * p_y
        u, v = (r_x + x) * scale - 0.5, (r_y + y) * scale - 0.5
        if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
            total += 50.0
            squares += 2500.0
            continue
        col, row = int(u), int(v)
        u, v = u - col, v - row
        corner, right, above, opposite = neighbours(view, row, col)
        m_00, m_01 = int(load(flat, corner)), int(load(flat, right))
        m_10, m_11 = int(load(flat, above)), int(load(flat, opposite))
        m_00, m_01 = m_00 if m_00 >= 0 else 50, m_01 if m_01 >= 0 else 50
        m_10, m_11 = m_10 if m_10 >= 0 else 50, m_11 if m_11 >= 0 else 50
        d_0, d_1 = float(m_01 - m_00), float(m_11 - m_10)
        low, high = m_00 + u * d_0, m_10 + u * d_1
        g_x, g_y = d_0 + v * (d_1 - d_0), high - low
        g_t = r_x * g_y - r_y * g_x
        m = low + v * g_y
        residual = 100.0 - m
        h_xx += g_x * g_x
        h_xy += g_x * g_y
        h_xt += g_x * g_t
        h_yy += g_y * g_y
        h_yt += g_y * g_t
        h_tt += g_t * g_t
        b_x += g_x * residual
        b_y += g_y * residual
        b_t += g_t * residual
        total += m
        squares += residual * residual
    # Convert percent and cells of the level to probabilities and finest cells.
    h, b = (0.01 * scale) ** 2, 1e-4 * scale
    hessian = (h * h_xx, h * h_xy, h * h_xt, h * h_yy, h * h_yt, h * h_tt)
    return Fit(*hessian, b * b_x, b * b_y, b * b_t, 0.01 * total, 1e-4 * squares)


@njit(cache=True, error_model="numpy")
def known_score_at(map, points, num_points, x, y, theta):
    """Return the number of scan points in known cells, and the mean occupancy of these cells from 0 to 1.

    Arguments as in `evaluate`.
    """
    view = at_level(map, 0)
    c, s = math.cos(theta), math.sin(theta)
    count = total = 0
    for k in range(num_points):
        p_x, p_y = float(points[0, k]), float(points[1, k])
        u, v = c * p_x - s * p_y + x, s * p_x + c * p_y + y
        if u >= 0.0 and v >= 0.0 and u < view.width and v < view.height:
            value = int(load(view.occupancy, neighbours(view, int(v), int(u))[0]))
            if value >= 0:
                count += 1
                total += value
    return count, 0.01 * total / max(count, 1)


@njit(cache=True, error_model="numpy")
def solve(fit, prior, x, y, theta):
    """Return the Gauss-Newton step (dx, dy, turn) [cells, cells, rad]; zeros if singular."""
    a, b, c = fit.h_xx + prior.w_xx, fit.h_xy + prior.w_xy, fit.h_xt + prior.w_xt
    d, e, f = fit.h_yy + prior.w_yy, fit.h_yt + prior.w_yt, fit.h_tt + prior.w_tt
    dx, dy, turn = prior.x - x, prior.y - y, prior.theta - theta
    r_x = fit.b_x + prior.w_xx * dx + prior.w_xy * dy + prior.w_xt * turn
    r_y = fit.b_y + prior.w_xy * dx + prior.w_yy * dy + prior.w_yt * turn
    r_t = fit.b_t + prior.w_xt * dx + prior.w_yt * dy + prior.w_tt * turn
    # Cramer's rule; the matrix is symmetric.
    m_xx, m_xy, m_xt = d * f - e * e, c * e - b * f, b * e - c * d
    m_yy, m_yt, m_tt = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * m_xx + b * m_xy + c * m_xt
    if not determinant > 1e-9 * a * d * f:
        return 0.0, 0.0, 0.0
    return (
        (m_xx * r_x + m_xy * r_y + m_xt * r_t) / determinant,
        (m_xy * r_x + m_yy * r_y + m_yt * r_t) / determinant,
        (m_xt * r_x + m_yt * r_y + m_tt * r_t) / determinant,
    )


@njit(cache=True, error_model="numpy")
def refine(map, num_levels, points, num_points, pose, prior, iterations, coarse_iterations):
    """Refine a pose by Gauss-Newton steps, coarsest map first; return x, y, heading and their `Fit`.

    `pose`: initial x, y from the map's corner [cells] and heading [rad]. `prior`: its heading must be unwrapped, within
    pi of the initial heading. `iterations` applies to the finest map, `coarse_iterations` to each other map. Other
    arguments as in `evaluate`.
    """
    x, y, theta = pose
    reach = 1.0
    for k in range(num_points):
        reach = max(reach, abs(points[0, k]) + abs(points[1, k]))
    fit = Fit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for level in range(num_levels - 1, -1, -1):
        is_small, limit = False, COARSE_STEP * 2**level if level else SMALL_STEP
        for _ in range(coarse_iterations if level else iterations):
            fit = evaluate(map, level, points, num_points, x, y, theta)
            dx, dy, turn = solve(fit, prior, x, y, theta)
            x, y, theta = x + dx, y + dy, theta + min(max(turn, -MAX_TURN), MAX_TURN)
            is_small = max(abs(dx), abs(dy), abs(turn) * reach) < limit
            if is_small:
                break
        if level == 0 and not is_small:
            fit = evaluate(map, level, points, num_points, x, y, theta)
    return x, y, theta, fit
