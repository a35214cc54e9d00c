"""Linearising the constraints of a pose graph."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from .residuals import chi_square, residual, robust_weight


class Linearised(NamedTuple):
    """Active constraints, sorted by node, linearised about the poses of the graph. Axes are those of the map frame."""

    starts: np.ndarray
    """Shape (num_nodes + 1,), int64: where the constraints of a node start."""
    submap: np.ndarray
    """Shape (n,), int64: index of the unknown submap, -1 for the one that is fixed."""
    information: np.ndarray
    """Shape (n, 3, 3), float64: weighted information."""
    product: np.ndarray
    """Shape (n, 3, 3), float64: information times the derivative of the node's predicted pose by the submap's pose."""
    gradient: np.ndarray
    """Shape (n, 3), float64: derivative of half the weighted chi^2 by the node's pose."""
    lever: np.ndarray
    """Shape (n, 2), float64: position of the node from the submap [m]."""


@njit(cache=True, error_model="numpy")
def _sort_by_node(constraints, num_nodes):
    """Return where the active constraints of each node start, and their indices in that order."""
    starts = np.zeros(num_nodes + 1, dtype=np.int64)
    for k in range(constraints.node.shape[0]):
        if constraints.is_active[k]:
            starts[constraints.node[k] + 1] += 1
    for j in range(num_nodes):
        starts[j + 1] += starts[j]
    filled = starts[:-1].copy()
    order = np.empty(starts[num_nodes], dtype=np.int64)
    for k in range(constraints.node.shape[0]):
        if constraints.is_active[k]:
            j = constraints.node[k]
            order[filled[j]] = k
            filled[j] += 1
    return starts, order


@njit(cache=True, error_model="numpy")
def _rotate_information(information, c, s, weight, out):
    """Write weight B^T information B to `out`, shape (3, 3), where B turns axes of the map frame into a submap's."""
    xx, xy, yy = information[0, 0], information[0, 1], information[1, 1]
    xt, yt = information[0, 2], information[1, 2]
    out[0, 0] = weight * (c * c * xx - 2.0 * c * s * xy + s * s * yy)
    out[1, 1] = weight * (s * s * xx + 2.0 * c * s * xy + c * c * yy)
    out[0, 1] = out[1, 0] = weight * (c * s * (xx - yy) + (c * c - s * s) * xy)
    out[0, 2] = out[2, 0] = weight * (c * xt - s * yt)
    out[1, 2] = out[2, 1] = weight * (s * xt + c * yt)
    out[2, 2] = weight * information[2, 2]


@njit(cache=True, error_model="numpy")
def linearise(graph, phi):
    """Linearise the active constraints of a `Graph`; `phi` is that of `robust_weight`.

    With e the residual, B its derivative by the node's pose and (dx, dy) the lever, the derivative by the submap's pose
    is -B T with T = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]].
    """
    constraints = graph.constraints
    starts, order = _sort_by_node(constraints, graph.nodes.shape[0])
    n = order.shape[0]
    submap, gradient, lever = np.empty(n, dtype=np.int64), np.empty((n, 3)), np.empty((n, 2))
    information, product = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    for i in range(n):
        k = order[i]
        node, frame = graph.nodes[constraints.node[k]], graph.submaps[constraints.submap[k]]
        x, y, theta = residual(frame, node, constraints.relative[k])
        given = constraints.information[k]
        weight = robust_weight(chi_square(given, x, y, theta), phi) if constraints.is_loop[k] else 1.0
        c, s = math.cos(frame[2]), math.sin(frame[2])
        rotated, dx, dy = information[i], node[0] - frame[0], node[1] - frame[1]
        _rotate_information(given, c, s, weight, rotated)
        ex, ey = c * x - s * y, s * x + c * y
        for r in range(3):
            gradient[i, r] = rotated[r, 0] * ex + rotated[r, 1] * ey + rotated[r, 2] * theta
            product[i, r, 0], product[i, r, 1] = rotated[r, 0], rotated[r, 1]
            product[i, r, 2] = rotated[r, 2] - dy * rotated[r, 0] + dx * rotated[r, 1]
        submap[i], lever[i, 0], lever[i, 1] = constraints.submap[k] - 1, dx, dy
    return Linearised(starts, submap, information, product, gradient, lever)
