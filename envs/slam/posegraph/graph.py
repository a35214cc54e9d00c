"""The pose graph: nodes, submaps, and constraints that each connect one node with one submap.

A node is the pose of the base at a scan, a submap the frame of a small map that was built from some tens of scans
(Hess et al., Real-time loop closure in 2D lidar SLAM, 2016). A node that was integrated into a submap is constrained to
it, and so is one that a loop closure has matched to it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike


class Constraints(NamedTuple):
    """Measured poses of nodes in the frames of submaps; n of them."""

    node: np.ndarray
    """Shape (n,), int32: index of the node."""
    submap: np.ndarray
    """Shape (n,), int32: index of the submap."""
    relative: np.ndarray
    """Shape (n, 3), float64: pose of the node in the submap's frame [m, m, rad]."""
    information: np.ndarray
    """Shape (n, 3, 3), float64: inverse of the covariance of `relative`, in the submap's frame [1/m^2, 1/rad^2]."""
    is_loop: np.ndarray
    """Shape (n,), bool: found by a loop closure; these alone can be wrong altogether, and are weighted robustly."""
    is_active: np.ndarray
    """Shape (n,), bool: False for constraints that were dropped."""


class Graph(NamedTuple):
    """A pose graph as kernels take it. Poses are in the map frame [m, m, rad]; the optimiser writes them."""

    submaps: np.ndarray
    """Shape (num_submaps, 3), float64: poses of submaps. The first one is fixed."""
    nodes: np.ndarray
    """Shape (num_nodes, 3), float64: poses of nodes."""
    constraints: Constraints


class GrowingArray:
    """An array that rows are appended to; its capacity doubles when it is full."""

    def __init__(self, row_shape: tuple[int, ...], dtype: DTypeLike, capacity: int) -> None:
        self._rows = np.zeros((capacity, *row_shape), dtype=dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: ArrayLike) -> int:
        """Append a row; return its index."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self._count] = row
        self._count += 1
        return self._count - 1

    @property
    def rows(self) -> np.ndarray:
        """View of the rows, valid until the next one is appended."""
        return self._rows[: self._count]


class PoseGraph:
    """A pose graph that grows."""

    def __init__(self, capacity: int = 64) -> None:
        """Make an empty graph with room for so many nodes before arrays are enlarged."""
        self._submaps = GrowingArray((3,), np.float64, capacity)
        self._nodes = GrowingArray((3,), np.float64, capacity)
        shapes: list[tuple[int, ...]] = [(), (), (3,), (3, 3), (), ()]
        kinds = (np.int32, np.int32, np.float64, np.float64, np.bool_, np.bool_)
        self._constraints = [GrowingArray(shape, kind, 2 * capacity) for shape, kind in zip(shapes, kinds)]

    @property
    def arrays(self) -> Graph:
        """Views of all arrays, valid until something is added. Poses may be written."""
        return Graph(self._submaps.rows, self._nodes.rows, Constraints(*(each.rows for each in self._constraints)))

    @property
    def num_nodes(self) -> int:
        """Number of nodes."""
        return len(self._nodes)

    @property
    def num_submaps(self) -> int:
        """Number of submaps."""
        return len(self._submaps)

    def add_node(self, pose: ArrayLike) -> int:
        """Add a node at a pose, map frame [m, m, rad]; return its index."""
        return self._nodes.append(pose)

    def add_submap(self, pose: ArrayLike) -> int:
        """Add a submap at a pose, map frame [m, m, rad]; return its index."""
        return self._submaps.append(pose)

    def add_constraint(
        self, node: int, submap: int, relative: ArrayLike, covariance: ArrayLike, is_loop: bool = False
    ) -> int:
        """Add a constraint; return its index. For the arguments see `Constraints`; `covariance` is that of `relative`.

        Raises:
            ValueError: there is no such node or submap, or the covariance is not positive definite.
        """
        if not (0 <= node < self.num_nodes and 0 <= submap < self.num_submaps):
            raise ValueError(
                f"node {node} or submap {submap} does not exist; there are {self.num_nodes} nodes and "
                f"{self.num_submaps} submaps"
            )
        covariance = np.asarray(covariance, dtype=np.float64)
        try:
            np.linalg.cholesky(covariance)
            information = np.linalg.inv(covariance)
        except np.linalg.LinAlgError as error:
            raise ValueError(f"covariance must be positive definite, got {covariance.tolist()}") from error
        row = (node, submap, relative, 0.5 * (information + information.T), is_loop, True)
        for each, value in zip(self._constraints, row):
            index = each.append(value)
        return index


@dataclass(frozen=True, slots=True)
class PoseGraphView:
    """Submaps and nodes as vertices of one graph, as files and pictures take it; dropped constraints are left out."""

    graph: Graph

    @property
    def nodes(self) -> np.ndarray:
        """Shape (num_submaps + num_nodes, 3), float64: poses of submaps, then of nodes, map frame [m, m, rad]."""
        return np.concatenate([self.graph.submaps, self.graph.nodes])

    @property
    def edges(self) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """Edges as `lidarnaut.envs.logs.runs.save_g2o` takes them, from submaps to nodes."""
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
