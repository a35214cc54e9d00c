"""Rendering a map from the scans of nodes, a few nodes at a time."""

import numpy as np

from envs.estimation import Correction, MapUpdate, Window
from envs.geometry import UNKNOWN
from envs.robots import LidarParams
from envs.slam.mapping.log_odds_map import LogOddsMap

from .nodes import NodeStore
from .params import GraphSlamParams

CHUNK = 256
"""Nodes that are integrated at once, at most."""


class MapRendering:
    """A map into which the nodes are integrated one after the other, in the order of time."""

    def __init__(self, params: GraphSlamParams, lidar: LidarParams) -> None:
        """Start with an unknown map."""
        self.map = LogOddsMap(params, lidar)
        self.count = 0
        """Nodes that were integrated."""

    def add(self, nodes: NodeStore, poses: np.ndarray, num_cells: float) -> bool:
        """Integrate the next nodes at their poses, shape (num_nodes, 3), map frame; return whether all are.

        At least one is, and as many as have beams over `num_cells` cells together.
        """
        geometry = self.map.geometry
        ranges = nodes.ranges[self.count : self.count + CHUNK]
        lengths = np.nan_to_num(ranges, nan=0.0).clip(0.0, geometry.range_max).sum(axis=1) / geometry.resolution
        count = 1 + int(np.searchsorted(np.cumsum(lengths[:-1]), num_cells)) if len(ranges) else 0
        last = self.count + count
        self.map.integrate_all(ranges[:count], poses[self.count : last])
        self.count = last
        return last == len(poses)

    def add_all(self, nodes: NodeStore, poses: np.ndarray) -> LogOddsMap:
        """Integrate all nodes, and return the map."""
        while not self.add(nodes, poses, np.inf):
            pass
        return self.map


def replace_cells(live: LogOddsMap, other: LogOddsMap, correction: Correction) -> MapUpdate:
    """Give a map the cells of another one; its grid stays the same object. Returns how that changes the map."""
    live.take_cells(other)
    height, width = live.grid.data.shape
    known = np.flatnonzero(live.grid.data != UNKNOWN)
    cells = np.empty((len(known), 2), dtype=np.int32)
    np.divmod(known, width, out=(cells[:, 0], cells[:, 1]), casting="unsafe")
    window = Window(0, 0, width - 1, height - 1)
    return MapUpdate(cells, window, redrawn=True, origin=live.grid.origin, correction=correction)


def has_moved(before: np.ndarray, after: np.ndarray, max_distance: float, max_angle: float) -> bool:
    """Tell whether a pose of `before`, shape (n, 3), lies farther from that of `after` than so much [m], [rad]."""
    if len(before) == 0:
        return False
    moved = after - before
    turned = np.abs(np.arctan2(np.sin(moved[:, 2]), np.cos(moved[:, 2])))
    return bool((moved[:, :2] ** 2).sum(axis=1).max() > max_distance**2 or turned.max() > max_angle)
