"""Gauss-Newton optimisation of a pose graph.

Nodes have constraints only to submaps, and are eliminated by the Schur complement (Triggs et al., 2000, section 6.1).
"""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import wrap_angle

from ..matching.covariance import invert
from .graph import Graph
from .skyline import factorise, row_starts, solve


class Linearised(NamedTuple):
    """Linearised constraints, sorted by node, map frame; without excluded outliers."""

    starts: np.ndarray
    """Index of the first constraint of each node, shape (num_nodes + 1,), int64."""
    submap: np.ndarray
    """Index of each constraint's submap among the optimised submaps, shape (n,), int64; -1 if fixed."""
    information: np.ndarray
    """Weighted information matrix of each constraint, map axes, shape (n, 3, 3), float64."""
    product: np.ndarray
    """Information matrix times Jacobian of the node pose with respect to the submap pose, shape (n, 3, 3), float64."""
    gradient: np.ndarray
    """Gradient of half the weighted chi-square with respect to the node pose, shape (n, 3), float64."""
    lever: np.ndarray
    """Node position minus submap position, map axes, shape (n, 2), float64 [m]."""


@njit(cache=True, error_model="numpy")
def residual(submap, node, relative):
    """Return the error of a measured node pose, submap frame [m, m, rad].

    `submap`, `node`: poses, map frame. `relative`: measured node pose, submap frame.
    """
    c, s = math.cos(submap[2]), math.sin(submap[2])
    dx, dy = node[0] - submap[0], node[1] - submap[1]
    theta = wrap_angle(node[2] - submap[2] - relative[2])
    return c * dx + s * dy - relative[0], c * dy - s * dx - relative[1], theta


@njit(cache=True, error_model="numpy")
def chi_square(information, x, y, theta):
    """Return the squared Mahalanobis distance of an error x, y [m], theta [rad]."""
    return (
        information[0, 0] * x * x
        + information[1, 1] * y * y
        + information[2, 2] * theta * theta
        + 2.0 * (information[0, 1] * x * y + information[0, 2] * x * theta + information[1, 2] * y * theta)
    )


@njit(cache=True, error_model="numpy")
def robust_weight(chi2, phi):
    """Return the weight of a loop closure by dynamic covariance scaling (Agarwal et al., 2013, eq. 15).

    The weight is below 1 for a chi-square above `phi`.
    """
    if chi2 <= phi:
        return 1.0
    scale = 2.0 * phi / (phi + chi2)
    return scale * scale


@njit(cache=True, error_model="numpy")
def _rotate_information(information, c, s, weight, out):
    xx, xy, yy = information[0, 0], information[0, 1], information[1, 1]
    xt, yt = information[0, 2], information[1, 2]
    out[0, 0] = weight * (c * c * xx - 2.0 * c * s * xy + s * s * yy)
    out[1, 1] = weight * (s * s * xx + 2.0 * c * s * xy + c * c * yy)
    out[0, 1] = out[1, 0] = weight * (c * s * (xx - yy) + (c * c - s * s) * xy)
    out[0, 2] = out[2, 0] = weight * (c * xt - s * yt)
    out[1, 2] = out[2, 1] = weight * (s * xt + c * yt)
    out[2, 2] = weight * information[2, 2]


@njit(cache=True, error_model="numpy")
def _linearise(graph, phi, order, starts):
    """Linearise the constraints of a pose graph at the current poses.

    The residual's Jacobian by the submap pose is -B T, with Jacobian B by the node pose, T = [[1, 0, -dy], [0, 1, dx],
    [0, 0, 1]], and node position (dx, dy) relative to the submap.
    """
    constraints, n = graph.constraints, order.shape[0]
    submap, gradient, lever = np.empty(n, dtype=np.int64), np.empty((n, 3)), np.empty((n, 2))
    information, product = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    for i in range(n):
        k = order[i]
        node, frame = graph.nodes[constraints.node[k]], graph.submaps[constraints.submap[k]]
        x, y, theta = residual(frame, node, constraints.relative[k])
        measured = constraints.information[k]
        weight = robust_weight(chi_square(measured, x, y, theta), phi) if constraints.is_loop[k] else 1.0
        c, s = math.cos(frame[2]), math.sin(frame[2])
        rotated, dx, dy = information[i], node[0] - frame[0], node[1] - frame[1]
        _rotate_information(measured, c, s, weight, rotated)
        ex, ey = c * x - s * y, s * x + c * y
        for r in range(3):
            gradient[i, r] = rotated[r, 0] * ex + rotated[r, 1] * ey + rotated[r, 2] * theta
            product[i, r, 0], product[i, r, 1] = rotated[r, 0], rotated[r, 1]
            product[i, r, 2] = rotated[r, 2] - dy * rotated[r, 0] + dx * rotated[r, 1]
        submap[i], lever[i, 0], lever[i, 1] = constraints.submap[k] - 1, dx, dy
    return Linearised(starts, submap, information, product, gradient, lever)


@njit(cache=True, error_model="numpy")
def _eliminate_nodes(linearised, num_nodes):
    inverse, shift, total = np.zeros((num_nodes, 3, 3)), np.zeros((num_nodes, 3)), np.empty((3, 3))
    for j in range(num_nodes):
        first, last = linearised.starts[j], linearised.starts[j + 1]
        if first == last:
            continue
        total[:] = 0.0
        for i in range(first, last):
            total += linearised.information[i]
        invert(total, inverse[j])
        for i in range(first, last):
            for r in range(3):
                for q in range(3):
                    shift[j, r] += inverse[j, r, q] * linearised.gradient[i, q]
    return inverse, shift


@njit(cache=True, error_model="numpy")
def _reduce(linearised, inverses, shifts, first, starts):
    values, rhs, half = np.zeros(starts[-1]), np.zeros(3 * first.shape[0]), np.empty((3, 3))
    for j in range(linearised.starts.shape[0] - 1):
        inverse, shift = inverses[j], shifts[j]
        for i in range(linearised.starts[j], linearised.starts[j + 1]):
            row = linearised.submap[i]
            if row < 0:
                continue
            product, gradient = linearised.product[i], linearised.gradient[i]
            dx, dy = linearised.lever[i, 0], linearised.lever[i, 1]
            width, at = 3 * (row + 1 - first[row]), starts[row] + 3 * (row - first[row])
            for q in range(3):
                values[at + q] += product[0, q]
                values[at + width + q] += product[1, q]
                values[at + 2 * width + q] += product[2, q] - dy * product[0, q] + dx * product[1, q]
            for r in range(3):
                rhs[3 * row + r] += gradient[r]
                for q in range(3):
                    rhs[3 * row + r] -= product[q, r] * shift[q]
                    half[r, q] = (
                        product[0, r] * inverse[0, q] + product[1, r] * inverse[1, q] + product[2, r] * inverse[2, q]
                    )
            rhs[3 * row + 2] += dx * gradient[1] - dy * gradient[0]
            for other in range(linearised.starts[j], linearised.starts[j + 1]):
                col = linearised.submap[other]
                if col < 0 or col > row:
                    continue
                factor, at = linearised.product[other], starts[row] + 3 * (col - first[row])
                for r in range(3):
                    for q in range(3):
                        values[at + r * width + q] -= (
                            half[r, 0] * factor[0, q] + half[r, 1] * factor[1, q] + half[r, 2] * factor[2, q]
                        )
    return values, rhs


@njit(cache=True, error_model="numpy")
def _move(poses, j, x, y, theta):
    poses[j, 0] += x
    poses[j, 1] += y
    poses[j, 2] = wrap_angle(poses[j, 2] + theta)
    return max(abs(x), abs(y), abs(theta))


@njit(cache=True, error_model="numpy")
def _move_nodes(graph, linearised, inverses, shifts, change):
    largest, pull = 0.0, np.empty(3)
    for j in range(graph.nodes.shape[0]):
        pull[:] = 0.0
        for i in range(linearised.starts[j], linearised.starts[j + 1]):
            row = linearised.submap[i]
            if row >= 0:
                for r in range(3):
                    for q in range(3):
                        pull[r] += linearised.product[i, r, q] * change[3 * row + q]
        inverse, shift = inverses[j], shifts[j]
        x = inverse[0, 0] * pull[0] + inverse[0, 1] * pull[1] + inverse[0, 2] * pull[2] - shift[0]
        y = inverse[1, 0] * pull[0] + inverse[1, 1] * pull[1] + inverse[1, 2] * pull[2] - shift[1]
        theta = inverse[2, 0] * pull[0] + inverse[2, 1] * pull[1] + inverse[2, 2] * pull[2] - shift[2]
        largest = max(largest, _move(graph.nodes, j, x, y, theta))
    return largest


@njit(cache=True, error_model="numpy")
def _step(graph, phi, order, starts, first, rows):
    linearised = _linearise(graph, phi, order, starts)
    inverses, shifts = _eliminate_nodes(linearised, graph.nodes.shape[0])
    values, change = _reduce(linearised, inverses, shifts, first, rows)
    factorise(values, first, rows)
    solve(values, first, rows, change)
    largest = _move_nodes(graph, linearised, inverses, shifts, change)
    for k in range(first.shape[0]):
        largest = max(largest, _move(graph.submaps, k + 1, change[3 * k], change[3 * k + 1], change[3 * k + 2]))
    return largest


def optimise_step(graph: Graph, phi: float) -> float:
    """Run one Gauss-Newton iteration; return the largest change of a pose coordinate [m or rad].

    The first submap and unconstrained poses do not move. Loop closures with a chi-square above `phi` have less weight;
    inf for plain least squares.
    """
    constraints, num_unknown = graph.constraints, max(len(graph.submaps) - 1, 0)
    active = np.flatnonzero(constraints.is_active)
    order = active[np.argsort(constraints.node[active], kind="stable")]
    starts = np.searchsorted(constraints.node[order], np.arange(len(graph.nodes) + 1))
    # First submap that shares a node with each submap.
    pairs = order[constraints.submap[order] > 0]
    node, submap = constraints.node[pairs], constraints.submap[pairs] - 1
    lowest, first = np.full(len(graph.nodes), num_unknown), np.arange(num_unknown)
    np.minimum.at(lowest, node, submap)
    np.minimum.at(first, submap, lowest[node])
    largest: float = _step(graph, phi, order, starts, first, row_starts(first))
    return largest


@njit(cache=True, error_model="numpy")
def chi_squares(graph):
    """Return the chi-square of all constraints, including excluded outliers, shape (n,), float64."""
    constraints = graph.constraints
    values = np.empty(constraints.node.shape[0])
    for k in range(values.shape[0]):
        node, submap = graph.nodes[constraints.node[k]], graph.submaps[constraints.submap[k]]
        x, y, theta = residual(submap, node, constraints.relative[k])
        values[k] = chi_square(constraints.information[k], x, y, theta)
    return values


def drop_outliers(graph: Graph, max_chi2: float) -> None:
    """Exclude loop closures with a chi-square above `max_chi2`."""
    graph.constraints.is_active[graph.constraints.is_loop & (chi_squares(graph) > max_chi2)] = False
