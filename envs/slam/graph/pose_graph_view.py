"""A pose graph as files and pictures take it: vertices, and edges between two of them."""

from dataclasses import dataclass

import numpy as np

from envs.slam.posegraph import Graph


@dataclass(frozen=True, slots=True)
class PoseGraphView:
    """Submaps and nodes as vertices of one graph; constraints that were dropped are left out."""

    graph: Graph

    @property
    def nodes(self) -> np.ndarray:
        """Shape (num_submaps + num_nodes, 3), float64: poses of submaps, then of nodes, map frame [m, m, rad]."""
        return np.concatenate([self.graph.submaps, self.graph.nodes])

    @property
    def edges(self) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """Edges as `envs.logs.runs.save_g2o` takes them, from submaps to nodes."""
        constraints, num_submaps = self.graph.constraints, len(self.graph.submaps)
        edges = []
        for k in np.flatnonzero(constraints.is_active).tolist():
            c, s = np.cos(constraints.relative[k, 2]), np.sin(constraints.relative[k, 2])
            # g2o has the information in the frame of the second vertex, the graph here in that of the first.
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            information = turn.T @ constraints.information[k] @ turn
            ends = int(constraints.submap[k]), num_submaps + int(constraints.node[k])
            edges.append((*ends, constraints.relative[k].copy(), information))
        return edges

    @property
    def loops(self) -> np.ndarray:
        """Shape (k, 2, 2), float64: positions of the submap and of the node of each loop closure, map frame [m]."""
        constraints = self.graph.constraints
        found = constraints.is_loop & constraints.is_active
        ends = self.graph.submaps[constraints.submap[found], :2], self.graph.nodes[constraints.node[found], :2]
        return np.stack(ends, axis=1)
