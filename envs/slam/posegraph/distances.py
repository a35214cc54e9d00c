"""How far submaps lie apart, along the graph (their poses err the more against each other) and in the plane."""

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def path_lengths(constraints, home_submap, travelled, source):
    """Return the lengths of the shortest paths through the graph from a submap to all others.

    From a submap to the next one it is the distance that the robot travelled; over a loop constraint it is 0.

    Args:
        constraints: `Constraints`; of these, active loop constraints are used.
        home_submap: shape (num_nodes,), int32, a submap that each node was integrated into.
        travelled: shape (num_submaps,), float64, distance that the robot had travelled when each submap started [m].
        source: index of the submap to start from.

    Returns:
        Shape (num_submaps,), float64 [m].
    """
    num_submaps = travelled.shape[0]
    lengths = np.abs(travelled - travelled[source])
    changed = True
    while changed:
        changed = False
        for k in range(constraints.node.shape[0]):
            if constraints.is_loop[k] and constraints.is_active[k]:
                a, b = home_submap[constraints.node[k]], constraints.submap[k]
                least = min(lengths[a], lengths[b])
                if lengths[a] > least or lengths[b] > least:
                    lengths[a] = lengths[b] = least
                    changed = True
        if changed:
            for k in range(1, num_submaps):
                lengths[k] = min(lengths[k], lengths[k - 1] + travelled[k] - travelled[k - 1])
            for k in range(num_submaps - 1, 0, -1):
                lengths[k - 1] = min(lengths[k - 1], lengths[k] + travelled[k] - travelled[k - 1])
    return lengths


@njit(cache=True, error_model="numpy")
def least_distances(nodes, spans, node):
    """Return how near each submap comes to a node: the distance to the nearest node that it holds.

    Args:
        nodes: shape (num_nodes, 3), float64, poses in the map frame [m, m, rad].
        spans: shape (num_submaps, 2), int64: first node of each submap, and the one after its last.
        node: index of the node.

    Returns:
        Shape (num_submaps,), float64 [m].
    """
    found = np.full(spans.shape[0], np.inf)
    for k in range(spans.shape[0]):
        for j in range(spans[k, 0], spans[k, 1]):
            dx, dy = nodes[j, 0] - nodes[node, 0], nodes[j, 1] - nodes[node, 1]
            found[k] = min(found[k], math.sqrt(dx * dx + dy * dy))
    return found
