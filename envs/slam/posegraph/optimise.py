"""Gauss-Newton optimisation of a pose graph.

Every node is constrained to few submaps and to no other node. So its three unknowns are eliminated (Schur complement,
as points are in bundle adjustment: Triggs et al., 2000, section 6.1), and what is left are three unknowns per submap.

One iteration is one call of `optimise_step`: a SLAM can spread an optimisation over scans by counting iterations.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry.pose import wrap_angle

from .linearise import linearise
from .skyline import factorise, row_starts, solve


class _Eliminated(NamedTuple):
    """What is needed to find the nodes' changes after those of submaps."""

    inverse: np.ndarray
    """Shape (num_nodes, 3, 3), float64: inverse of the sum of a node's information."""
    shift: np.ndarray
    """Shape (num_nodes, 3), float64: `inverse` times the sum of its gradients."""


@njit(cache=True, error_model="numpy")
def _invert(matrix, out):
    """Write the inverse of a symmetric positive definite matrix, both of shape (3, 3)."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * aa + b * bb + c * cc)
    out[0, 0], out[1, 1], out[2, 2] = scale * aa, scale * (a * f - c * c), scale * (a * d - b * b)
    out[0, 1] = out[1, 0] = scale * bb
    out[0, 2] = out[2, 0] = scale * cc
    out[1, 2] = out[2, 1] = scale * (b * c - a * e)


@njit(cache=True, error_model="numpy")
def _eliminate_nodes(linearised, num_nodes):
    """Return `_Eliminated` of all nodes; zeros for nodes without constraints, which therefore stay where they are."""
    inverse, shift, total = np.zeros((num_nodes, 3, 3)), np.zeros((num_nodes, 3)), np.empty((3, 3))
    for j in range(num_nodes):
        first, last = linearised.starts[j], linearised.starts[j + 1]
        if first == last:
            continue
        total[:] = 0.0
        for i in range(first, last):
            for r in range(3):
                for q in range(3):
                    total[r, q] += linearised.information[i, r, q]
        _invert(total, inverse[j])
        for i in range(first, last):
            for r in range(3):
                for q in range(3):
                    shift[j, r] += inverse[j, r, q] * linearised.gradient[i, q]
    return _Eliminated(inverse, shift)


@njit(cache=True, error_model="numpy")
def _first_blocks(linearised, num_unknown):
    """Return the first submap that each submap shares a node with, itself included: shape (num_unknown,), int64."""
    first = np.arange(num_unknown)
    for j in range(linearised.starts.shape[0] - 1):
        lowest = num_unknown
        for i in range(linearised.starts[j], linearised.starts[j + 1]):
            if 0 <= linearised.submap[i] < lowest:
                lowest = linearised.submap[i]
        for i in range(linearised.starts[j], linearised.starts[j + 1]):
            if linearised.submap[i] >= 0:
                first[linearised.submap[i]] = min(first[linearised.submap[i]], lowest)
    return first


@njit(cache=True, error_model="numpy")
def _add_constraint(linearised, i, at, width, values):
    """Add T^T information T of constraint i to the diagonal block of its submap, which starts at `at`."""
    product, dx, dy = linearised.product[i], linearised.lever[i, 0], linearised.lever[i, 1]
    for q in range(3):
        values[at + q] += product[0, q]
        values[at + width + q] += product[1, q]
        values[at + 2 * width + q] += product[2, q] - dy * product[0, q] + dx * product[1, q]


@njit(cache=True, error_model="numpy")
def _reduce(linearised, eliminated, first, starts):
    """Return matrix and right-hand side of the submaps' normal equations, after elimination of the nodes.

    The matrix is a skyline with `first` and `starts`, see `skyline.py`; the right-hand side has shape (3 num_unknown,).
    """
    values, rhs, half = np.zeros(starts[-1]), np.zeros(3 * first.shape[0]), np.empty((3, 3))
    for j in range(linearised.starts.shape[0] - 1):
        inverse, shift = eliminated.inverse[j], eliminated.shift[j]
        for i in range(linearised.starts[j], linearised.starts[j + 1]):
            row = linearised.submap[i]
            if row < 0:
                continue
            product, gradient = linearised.product[i], linearised.gradient[i]
            width = 3 * (row + 1 - first[row])
            _add_constraint(linearised, i, starts[row] + 3 * (row - first[row]), width, values)
            for r in range(3):
                rhs[3 * row + r] += gradient[r]
                for q in range(3):
                    rhs[3 * row + r] -= product[q, r] * shift[q]
                    half[r, q] = (
                        product[0, r] * inverse[0, q] + product[1, r] * inverse[1, q] + product[2, r] * inverse[2, q]
                    )
            rhs[3 * row + 2] += linearised.lever[i, 0] * gradient[1] - linearised.lever[i, 1] * gradient[0]
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
    """Add a change to a pose; return the largest part of it."""
    poses[j, 0] += x
    poses[j, 1] += y
    poses[j, 2] = wrap_angle(poses[j, 2] + theta)
    return max(abs(x), abs(y), abs(theta))


@njit(cache=True, error_model="numpy")
def _move_nodes(graph, linearised, eliminated, change):
    """Move the nodes as follows from the changes of the submaps; return the largest change."""
    largest, pull = 0.0, np.empty(3)
    for j in range(graph.nodes.shape[0]):
        pull[:] = 0.0
        for i in range(linearised.starts[j], linearised.starts[j + 1]):
            row = linearised.submap[i]
            if row >= 0:
                for r in range(3):
                    for q in range(3):
                        pull[r] += linearised.product[i, r, q] * change[3 * row + q]
        inverse, shift = eliminated.inverse[j], eliminated.shift[j]
        x = inverse[0, 0] * pull[0] + inverse[0, 1] * pull[1] + inverse[0, 2] * pull[2] - shift[0]
        y = inverse[1, 0] * pull[0] + inverse[1, 1] * pull[1] + inverse[1, 2] * pull[2] - shift[1]
        theta = inverse[2, 0] * pull[0] + inverse[2, 1] * pull[1] + inverse[2, 2] * pull[2] - shift[2]
        largest = max(largest, _move(graph.nodes, j, x, y, theta))
    return largest


@njit(cache=True, error_model="numpy")
def optimise_step(graph, phi):
    """Move nodes and submaps by one iteration of Gauss-Newton; the first submap is fixed.

    What no constraint determines stays where it is.

    Args:
        graph: `Graph`; its poses are written.
        phi: chi^2 above which loop constraints weigh less, see `robust_weight`; inf for plain least squares.

    Returns:
        Largest change of a coordinate of a pose [m or rad].
    """
    linearised = linearise(graph, phi)
    eliminated = _eliminate_nodes(linearised, graph.nodes.shape[0])
    num_unknown = max(graph.submaps.shape[0] - 1, 0)
    first = _first_blocks(linearised, num_unknown)
    starts = row_starts(first)
    values, change = _reduce(linearised, eliminated, first, starts)
    factorise(values, first, starts)
    solve(values, first, starts, change)
    largest = _move_nodes(graph, linearised, eliminated, change)
    for k in range(num_unknown):
        largest = max(largest, _move(graph.submaps, k + 1, change[3 * k], change[3 * k + 1], change[3 * k + 2]))
    return largest


@njit(cache=True, error_model="numpy")
def optimise(graph, phi, max_iterations, tolerance):
    """Iterate `optimise_step` until no pose changes by `tolerance` [m or rad]; return the number of iterations."""
    for k in range(max_iterations):
        if optimise_step(graph, phi) < tolerance:
            return k + 1
    return max_iterations
