"""Pose graph of nodes and submaps (Hess et al., Real-time loop closure in 2D lidar SLAM, 2016).

A node is the base pose at a scan; a submap is the frame of a map from some tens of scans.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lidarnaut.envs.geometry import GrowingArray


class Constraints(NamedTuple):
    """Constraints of a pose graph: node poses measured in submap frames."""

    node: np.ndarray
    submap: np.ndarray
    relative: np.ndarray
    """Measured node poses, shape (n, 3), float64, submap frame [m, m, rad]."""
    information: np.ndarray
    """Inverse covariances of measured poses, shape (n, 3, 3), float64, submap frame [1/m^2, 1/rad^2]."""
    is_loop: np.ndarray
    """Loop-closure flags, shape (n,), bool. Loop closures have robust weights against outliers."""
    is_active: np.ndarray
    """False for constraints excluded as outliers, shape (n,), bool."""


class Graph(NamedTuple):
    """Poses and constraints of a pose graph, map frame [m, m, rad]; the optimiser updates the poses."""

    submaps: np.ndarray
    """Submap poses, shape (num_submaps, 3), float64, map frame; the first is fixed."""
    nodes: np.ndarray
    """Node poses, shape (num_nodes, 3), float64, map frame."""
    constraints: Constraints


class PoseGraph:
    """Growing pose graph of nodes, submaps and constraints, map frame [m, m, rad]."""

    def __init__(self) -> None:
        self._submaps = GrowingArray((3,), np.float64, 64)
        self._nodes = GrowingArray((3,), np.float64, 64)
        shapes: list[tuple[int, ...]] = [(), (), (3,), (3, 3), (), ()]
        kinds = (np.int32, np.int32, np.float64, np.float64, np.bool_, np.bool_)
        self._constraints = [GrowingArray(shape, kind, 128) for shape, kind in zip(shapes, kinds)]

    @property
    def arrays(self) -> Graph:
        """Writable views of poses and constraints, valid until the graph grows."""
        return Graph(self._submaps.rows, self._nodes.rows, Constraints(*(each.rows for each in self._constraints)))

    @property
    def num_submaps(self) -> int:
        return len(self._submaps)

    def add_node(self, pose: ArrayLike) -> int:
        return self._nodes.append(pose)

    def add_submap(self, pose: ArrayLike) -> int:
        return self._submaps.append(pose)

    def add_constraint(
        self, node: int, submap: int, relative: ArrayLike, covariance: ArrayLike, is_loop: bool = False
    ) -> None:
        """Add a measured node pose `relative`, submap frame [m, m, rad], as a constraint.

        `covariance`: of `relative`, positive definite.
        """
        information = np.linalg.inv(np.asarray(covariance, dtype=np.float64))
        row = (node, submap, relative, 0.5 * (information + information.T), is_loop, True)
        for each, value in zip(self._constraints, row):
            each.append(value)


@dataclass(frozen=True, slots=True)
class PoseGraphView:
    """Pose graph without excluded outliers, for files and plots."""

    graph: Graph

    @property
    def nodes(self) -> np.ndarray:
        """Submap poses, then node poses, shape (num_submaps + num_nodes, 3), float64, map frame [m, m, rad]."""
        return np.concatenate([self.graph.submaps, self.graph.nodes])

    @property
    def edges(self) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """Constraints for g2o files: submap index, node index, relative pose, and information in the node frame."""
        constraints, num_submaps = self.graph.constraints, len(self.graph.submaps)
        edges = []
        for k in np.flatnonzero(constraints.is_active).tolist():
            c, s = np.cos(constraints.relative[k, 2]), np.sin(constraints.relative[k, 2])
            # g2o expects information in the frame of the second vertex.
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            information = turn.T @ constraints.information[k] @ turn
            ends = int(constraints.submap[k]), num_submaps + int(constraints.node[k])
            edges.append((*ends, constraints.relative[k].copy(), information))
        return edges

    @property
    def loops(self) -> np.ndarray:
        """Positions of submap and node of each loop closure, shape (k, 2, 2), float64, map frame [m]."""
        constraints = self.graph.constraints
        found = constraints.is_loop & constraints.is_active
        ends = self.graph.submaps[constraints.submap[found], :2], self.graph.nodes[constraints.node[found], :2]
        return np.stack(ends, axis=1)
