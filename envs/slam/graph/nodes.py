import numpy as np

from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import GrowingArray, Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam.key_scans import KeyScans
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.gauss_newton import refine
from lidarnaut.envs.slam.matching.scan_matcher import make_prior
from lidarnaut.envs.slam.slam_params import GraphSlamParams

MAX_BATCH = 256
FINAL_STDS = np.array([0.05, 0.05, 0.01])
"""Standard deviations of node poses as priors of the final scan matching [m, m, rad]."""


class NodeStore(KeyScans):
    """Scans of all pose-graph nodes, and first and last node of each submap.

    Poses are in the local frame (scan matching without loop-closure corrections). A submap frame has its origin at the
    first node.
    """

    def __init__(self, lidar: LidarParams) -> None:
        super().__init__(lidar)
        self.spans = GrowingArray((2,), np.int64, 32)
        """Index of the first node of each submap, and index after the last."""
        self.home = GrowingArray((), np.int32, 256)
        """Index of the newest submap that contains each node."""
        self.travelled = GrowingArray((), np.float64, 32)
        """Distance travelled until the start of each submap [m]."""
        self.first_joined = 0
        """Index of the first node that is connected to later nodes by odometry."""

    def add_submap(self, travelled: float) -> int:
        """Start a submap at the next node; return the submap index. `travelled`: distance travelled so far [m]."""
        self.travelled.append(travelled)
        return self.spans.append((len(self), len(self)))

    def add_node(self, ranges: np.ndarray, pose: Pose2D, submaps: list[int]) -> int:
        """Store a scan and its base pose, local frame, as a graph node; return the node index.

        `submaps`: indices of the submaps that contain it, newest last.
        """
        node = self.add(ranges, pose)
        self.home.append(submaps[-1])
        self.spans.rows[submaps, 1] = node + 1
        return node

    def submap_pose(self, submap: int) -> Pose2D:
        """Return the pose of a submap without loop-closure corrections: position of its first node, heading 0."""
        x, y, _ = self.poses[self.spans.rows[submap, 0]].tolist()
        return Pose2D(x, y, 0.0)

    def submap_scans(self, submap: int) -> tuple[np.ndarray, np.ndarray]:
        """Return scans of a submap, shape (n, num_beams), float32 [m], and base poses, shape (n, 3), submap frame."""
        first, last = self.spans.rows[submap].tolist()
        return self.ranges[first:last], self.poses[first:last] - np.array(self.submap_pose(submap))

    def recent_points(self, node: int, count: int, max_range: float, max_points: int) -> np.ndarray:
        """Merge the points of a node's scan and earlier scans, shape (n, 2), float32, base frame of the node [m].

        Limits: `count` scans connected by odometry, range `max_range` [m], and `max_points`.
        """
        return self.joined_points(min(max(node - count + 1, self.first_joined, 0), node), node, max_range, max_points)


class MapRendering:
    """Map that is rebuilt from the scans of all nodes, some scans per call to limit the time."""

    def __init__(self, params: GraphSlamParams, lidar: LidarParams) -> None:
        self.map = LogOddsMap(params, lidar)
        self.count = 0

    def add(self, nodes: NodeStore, poses: np.ndarray, num_cells: float) -> bool:
        """Insert the next scans into the map; return True if all scans are inserted.

        `num_cells` limits the cells along beams, but at least one scan is inserted. `poses`: shape (num_nodes, 3), map
        frame.
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
        while not self.add(nodes, poses, np.inf):
            pass
        return self.map


def any_pose_moved(before: np.ndarray, after: np.ndarray, max_distance: float, max_angle: float) -> bool:
    """Return True if any pose, shape (n, 3), n > 0 [m, m, rad], moved more than a distance [m] or angle [rad]."""
    moved = after - before
    turned = np.abs(np.arctan2(np.sin(moved[:, 2]), np.cos(moved[:, 2])))
    return bool((moved[:, :2] ** 2).sum(axis=1).max() > max_distance**2 or turned.max() > max_angle)


def refine_poses(params: GraphSlamParams, lidar: LidarParams, nodes: NodeStore, poses: np.ndarray) -> np.ndarray:
    """Match the scans of all nodes to their common map; return poses, shape (num_nodes, 3), map frame [m, m, rad]."""
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
