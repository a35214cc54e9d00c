"""Rendering a map from the scans of nodes, a few nodes at a time, and matching nodes with it."""

import numpy as np

from envs.estimation import Correction, MapUpdate, Window
from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.growing_map import known_cells
from envs.slam.log_odds_map import LogOddsMap
from envs.slam.matching.gauss_newton import refine
from envs.slam.matching.scan_matcher import make_prior
from envs.slam.params import GraphSlamParams
from envs.slam.scans import project_hits

from .nodes import NodeStore

CHUNK = 256
"""Nodes that are integrated at once, at most."""
FINAL_STDS = np.array([0.05, 0.05, 0.01])
"""Standard deviations of nodes' poses before they are matched with the map of all of them [m, m, rad]."""


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
    window = Window(0, 0, width - 1, height - 1)
    return MapUpdate(known_cells(live.grid.data), window, redrawn=True, origin=live.grid.origin, correction=correction)


def has_moved(before: np.ndarray, after: np.ndarray, max_distance: float, max_angle: float) -> bool:
    """Tell whether a pose of `before`, shape (n, 3), lies farther from that of `after` than so much [m], [rad]."""
    if len(before) == 0:
        return False
    moved = after - before
    turned = np.abs(np.arctan2(np.sin(moved[:, 2]), np.cos(moved[:, 2])))
    return bool((moved[:, :2] ** 2).sum(axis=1).max() > max_distance**2 or turned.max() > max_angle)


def refine_poses(params: GraphSlamParams, lidar: LidarParams, nodes: NodeStore, poses: np.ndarray) -> np.ndarray:
    """Return where nodes at `poses`, shape (num_nodes, 3), map frame [m, m, rad], fit the map of all of them best."""
    map, refined = MapRendering(params, lidar).add_all(nodes, poses), np.array(poses)
    points, resolution = np.empty((2, lidar.num_beams), dtype=np.float32), params.resolution
    covariance, variance = np.diag(FINAL_STDS**2), params.residual_variance
    for k in range(len(poses)):
        count = project_hits(nodes.ranges[k], map.geometry, points)
        x, y, theta = poses[k].tolist()
        start = (*map.to_cells(x, y), theta)
        prior = make_prior(start, covariance, variance, resolution)
        over, steps = (map.levels, params.num_levels, points, count), (params.iterations, params.coarse_iterations)
        x, y, theta, _ = refine(*over, start, prior, *steps)
        refined[k] = Pose2D(*map.to_metres(x, y), theta)
    return refined
