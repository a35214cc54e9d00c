"""Nodes: their scans, the submaps that hold them, and the map that is rendered from them, a few at a time."""

import numpy as np

from lidarnaut.envs.estimation import Correction, MapUpdate, Window
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam.growing_map import known_cells
from lidarnaut.envs.slam.key_scans import KeyScans
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.gauss_newton import refine
from lidarnaut.envs.slam.matching.scan_matcher import make_prior
from lidarnaut.envs.slam.params import GraphSlamParams
from lidarnaut.envs.slam.posegraph import GrowingArray
from lidarnaut.envs.slam.scans import project_hits

MAX_BATCH = 256
"""Nodes that are integrated at once, at most."""
FINAL_STDS = np.array([0.05, 0.05, 0.01])
"""Standard deviations of nodes' poses before they are matched with the map of all of them [m, m, rad]."""


class NodeStore(KeyScans):
    """Scans of all nodes, and which of them each submap holds.

    The local frame is that of the scan matcher, and is never corrected. A submap's frame lies at its first node, with
    the axes of the local frame. Its nodes follow one another, so that first and last say which they are.
    """

    def __init__(self, lidar: LidarParams) -> None:
        """Make an empty store for scans of a lidar."""
        super().__init__(lidar)
        self._submaps = GrowingArray((2,), np.int64, 32)
        self._home = GrowingArray((), np.int32, 256)
        self._travelled = GrowingArray((), np.float64, 32)
        self._first_joined = 0

    @property
    def num_submaps(self) -> int:
        """Number of submaps."""
        return len(self._submaps)

    @property
    def home(self) -> np.ndarray:
        """Shape (num_nodes,), int32: the newest submap that each node was integrated into."""
        return self._home.rows

    @property
    def spans(self) -> np.ndarray:
        """Shape (num_submaps, 2), int64: first node of each submap, and the one after its last."""
        return self._submaps.rows

    @property
    def travelled(self) -> np.ndarray:
        """Shape (num_submaps,), float64: distance that the robot had travelled when a submap started [m]."""
        return self._travelled.rows

    def break_off(self) -> None:
        """Note that odometry does not join the nodes that follow with those so far."""
        self._first_joined = len(self)

    def add_submap(self, travelled: float) -> int:
        """Start a submap with the node that is added next; return its index."""
        self._travelled.append(travelled)
        return self._submaps.append((len(self), len(self)))

    def add_node(self, ranges: np.ndarray, pose: Pose2D, submaps: list[int]) -> int:
        """Add a node, its pose in the local frame, to submaps, the newest last; return its index."""
        node = self.add(ranges, pose)
        self._home.append(submaps[-1])
        self.spans[submaps, 1] = node + 1
        return node

    def submap_pose(self, submap: int) -> Pose2D:
        """Return the pose of a submap in the local frame."""
        x, y, _ = self.poses[self.spans[submap, 0]].tolist()
        return Pose2D(x, y, 0.0)

    def submap_scans(self, submap: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the scans of a submap, and their poses in its frame: shapes (n, num_beams), float32, and (n, 3)."""
        first, last = self.spans[submap].tolist()
        return self.ranges[first:last], self.poses[first:last] - np.array(self.submap_pose(submap))

    def recent_points(self, node: int, count: int, max_range: float, max_points: int) -> np.ndarray:
        """Return the joined points of the last nodes up to this one; see `joined_points`.

        Nodes that odometry does not join with the newest one are left out.
        """
        return self.joined_points(min(max(node - count + 1, self._first_joined, 0), node), node, max_range, max_points)


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
        ranges = nodes.ranges[self.count : self.count + MAX_BATCH]
        lengths = np.nan_to_num(ranges, nan=0.0).clip(0.0, geometry.range_max).sum(axis=1) / geometry.resolution
        if len(ranges):
            count = 1 + int(np.searchsorted(np.cumsum(lengths[:-1]), num_cells))
            self.map.integrate_all(ranges[:count], poses[self.count : self.count + count])
            self.count += count
        return self.count == len(poses)

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


def any_pose_moved(before: np.ndarray, after: np.ndarray, max_distance: float, max_angle: float) -> bool:
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
