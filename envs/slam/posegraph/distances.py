"""How far submaps lie apart along the graph: by as much could their poses be wrong against each other."""

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
