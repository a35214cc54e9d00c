"""Pose graphs of the plane as g2o text: VERTEX_SE2 and EDGE_SE2 lines.

Kümmerle et al., g2o: A general framework for graph optimization, ICRA 2011.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from envs.files import write_file

_UPPER = np.triu_indices(3)


class Edge(NamedTuple):
    """A relative pose between two nodes."""

    first: int
    """Row of the node in whose frame the motion is given."""
    second: int
    """Row of the node that the motion leads to."""
    motion: np.ndarray
    """Shape (3,), float64: the second node as seen from the first, x, y, heading [m, m, rad]."""
    information: np.ndarray
    """Shape (3, 3), float64: inverse of the motion's covariance [1/m2, 1/(m rad), 1/rad2]."""


class PoseGraph(NamedTuple):
    """Poses and what was measured between them."""

    nodes: np.ndarray
    """Shape (n, 3), float64: x, y, heading, map frame [m, m, rad]."""
    edges: list[Edge]


def save_g2o(path: Path, nodes: np.ndarray, edges: Iterable[tuple[int, int, np.ndarray, np.ndarray]]) -> None:
    """Write a pose graph whose first node is held fixed.

    Args:
        path: the file.
        nodes: shape (n, 3): x, y, heading [m, m, rad].
        edges: tuples as `Edge`.

    Raises:
        ValueError: an edge leads to a node that does not exist, or a number is not finite.
    """
    lines = [f"VERTEX_SE2 {k} {_join(node)}" for k, node in enumerate(np.reshape(nodes, (-1, 3)))]
    num_nodes = len(lines)
    if lines:
        lines.append("FIX 0")
    for first, second, motion, information in edges:
        if not (0 <= first < num_nodes and 0 <= second < num_nodes):
            raise ValueError(f"edge from {first} to {second} in a graph of {num_nodes} nodes")
        upper = np.asarray(information)[_UPPER]
        lines.append(f"EDGE_SE2 {first} {second} {_join(motion)} {_join(upper)}")
    write_file(path, "".join(f"{line}\n" for line in lines))


def load_g2o(path: str | Path) -> PoseGraph:
    """Read a pose graph; nodes are numbered by their order in the file, whatever their ids are.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a line is damaged or of another kind, or an edge leads to a node that does not exist.
    """
    rows: dict[int, int] = {}
    nodes: list[np.ndarray] = []
    edges: list[tuple[int, int, int, np.ndarray]] = []
    for number, line in enumerate(Path(path).read_text(encoding="ascii", errors="replace").splitlines(), start=1):
        kind, *fields = line.split() or [""]
        try:
            if kind == "VERTEX_SE2":
                node, *values = int(fields[0]), *map(float, fields[1:])
                if node in rows:
                    raise ValueError(f"second node {node}")
                rows[node] = len(nodes)
                nodes.append(_checked(values, 3))
            elif kind == "EDGE_SE2":
                first, second = int(fields[0]), int(fields[1])
                edges.append((number, first, second, _checked(list(map(float, fields[2:])), 9)))
            elif kind not in ("", "FIX"):
                raise ValueError("only VERTEX_SE2, EDGE_SE2 and FIX are known")
        except (ValueError, IndexError) as error:
            raise ValueError(f"{path}, line {number}: bad {kind} line: {error}") from error
    found = []
    for number, first, second, measured in edges:  # edges may stand before their nodes
        if missing := {first, second} - rows.keys():
            raise ValueError(f"{path}, line {number}: there is no node {min(missing)}")
        information = np.zeros((3, 3))
        information[_UPPER] = measured[3:]
        information += np.triu(information, 1).T
        found.append(Edge(rows[first], rows[second], measured[:3], information))
    return PoseGraph(np.array(nodes).reshape(-1, 3), found)


def _join(values: np.ndarray) -> str:
    if not np.isfinite(values).all():
        raise ValueError(f"a pose graph holds finite numbers only, got {np.asarray(values).tolist()}")
    return " ".join(repr(float(value)) for value in values)


def _checked(values: list[float], count: int) -> np.ndarray:
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{count} finite numbers are needed, got {values}")
    return np.array(values)
