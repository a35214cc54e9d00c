"""Residuals of constraints, their robust weights, and dropping of outliers."""

import math

import numpy as np
from numba import njit

from envs.geometry.pose import wrap_angle


@njit(cache=True, error_model="numpy")
def residual(submap, node, relative):
    """Return the residual of a constraint, in the submap's frame, as (x, y, theta) [m, m, rad].

    Args:
        submap: shape (3,), float64, pose of the submap [m, m, rad].
        node: shape (3,), float64, pose of the node [m, m, rad].
        relative: shape (3,), float64, measured pose of the node in the submap's frame [m, m, rad].
    """
    c, s = math.cos(submap[2]), math.sin(submap[2])
    dx, dy = node[0] - submap[0], node[1] - submap[1]
    theta = wrap_angle(node[2] - submap[2] - relative[2])
    return c * dx + s * dy - relative[0], c * dy - s * dx - relative[1], theta


@njit(cache=True, error_model="numpy")
def chi_square(information, x, y, theta):
    """Return the squared Mahalanobis distance of a residual; `information` has shape (3, 3)."""
    return (
        information[0, 0] * x * x
        + information[1, 1] * y * y
        + information[2, 2] * theta * theta
        + 2.0 * (information[0, 1] * x * y + information[0, 2] * x * theta + information[1, 2] * y * theta)
    )


@njit(cache=True, error_model="numpy")
def robust_weight(chi2, phi):
    """Return the weight of a loop constraint by dynamic covariance scaling (Agarwal et al., 2013, eq. 15).

    It is 1 up to a chi^2 of `phi`, and falls as the square of 2 phi / (phi + chi^2) above. No scaling if `phi` is inf.
    """
    if chi2 <= phi:
        return 1.0
    scale = 2.0 * phi / (phi + chi2)
    return scale * scale


@njit(cache=True, error_model="numpy")
def chi_squares(graph):
    """Return chi^2 of all constraints of a `Graph`, dropped ones included: shape (n,), float64."""
    constraints = graph.constraints
    values = np.empty(constraints.node.shape[0])
    for k in range(values.shape[0]):
        node, submap = graph.nodes[constraints.node[k]], graph.submaps[constraints.submap[k]]
        x, y, theta = residual(submap, node, constraints.relative[k])
        values[k] = chi_square(constraints.information[k], x, y, theta)
    return values


@njit(cache=True, error_model="numpy")
def drop_outliers(graph, max_chi2):
    """Drop the loop constraints of a `Graph` whose chi^2 exceeds `max_chi2`; return how many were dropped.

    To be called after optimisation. What is dropped stays dropped.
    """
    constraints = graph.constraints
    values = chi_squares(graph)
    count = 0
    for k in range(values.shape[0]):
        if constraints.is_loop[k] and constraints.is_active[k] and values[k] > max_chi2:
            constraints.is_active[k] = False
            count += 1
    return count
