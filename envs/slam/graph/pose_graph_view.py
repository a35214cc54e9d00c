"""A pose graph as files and pictures take it: vertices, and edges between two of them."""

from typing import NamedTuple

import numpy as np

from envs.slam.posegraph import Graph


class PoseGraphView(NamedTuple):
    """Submaps and nodes as vertices of one graph."""

    nodes: np.ndarray
    """Shape (num_submaps + num_nodes, 3), float64: poses of submaps, then of nodes, map frame [m, m, rad]."""
    edges: list[tuple[int, int, np.ndarray, np.ndarray]]
    """Submap, node, pose of the node as seen from the submap, and its information in the node's frame, as g2o has
    it; see `envs.logs.g2o.Edge`."""
    num_submaps: int
    """How many of the vertices are submaps."""
    loops: np.ndarray
    """Shape (k, 2), int64: the vertices that loop closures connect, submap and node."""


def view_of(graph: Graph) -> PoseGraphView:
    """Return the view of a graph, without constraints that were dropped; arrays are copies."""
    constraints, num_submaps = graph.constraints, len(graph.submaps)
    active = np.flatnonzero(constraints.is_active)
    edges = []
    for k in active.tolist():
        c, s = np.cos(constraints.relative[k, 2]), np.sin(constraints.relative[k, 2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        information = turn.T @ constraints.information[k] @ turn
        ends = int(constraints.submap[k]), num_submaps + int(constraints.node[k])
        edges.append((*ends, constraints.relative[k].copy(), information))
    is_loop = active[constraints.is_loop[active]]
    loops = np.column_stack([constraints.submap[is_loop], constraints.node[is_loop] + num_submaps]).astype(np.int64)
    return PoseGraphView(np.concatenate([graph.submaps, graph.nodes]), edges, num_submaps, loops)
