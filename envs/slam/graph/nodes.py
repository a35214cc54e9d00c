"""What is kept of nodes and submaps beside the pose graph: scans, and poses in the local frame."""

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.matching.submap_field import FieldGeometry, Scans, SensorModel, render_field
from envs.slam.posegraph.records import GrowingArray

MODEL = SensorModel()
"""How scans are integrated into submaps."""


class NodeStore:
    """Scans of all nodes, and which of them each submap holds.

    The local frame is that of the scan matcher, and is never corrected. A submap's frame lies at its first node, with
    the axes of the local frame. Its nodes follow one another, so that first and last say which they are.
    """

    def __init__(self, lidar: LidarParams) -> None:
        """Make an empty store for scans of a lidar."""
        self.mount = float(lidar.mount.x), float(lidar.mount.y)
        self._ranges = GrowingArray((lidar.num_beams,), np.float32, 256)
        self._points = GrowingArray((2,), np.float32, 1 << 14)
        self._spans = GrowingArray((2,), np.int64, 256)
        self._poses = GrowingArray((3,), np.float64, 256)
        self._submaps = GrowingArray((2,), np.int64, 32)
        self._home = GrowingArray((), np.int32, 256)
        self._travelled = GrowingArray((), np.float64, 32)
        self._first_joined = 0

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def num_submaps(self) -> int:
        """Number of submaps."""
        return len(self._submaps)

    @property
    def poses(self) -> np.ndarray:
        """Shape (num_nodes, 3), float64: poses of nodes in the local frame [m, m, rad]."""
        return self._poses.rows

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

    def add_node(self, ranges: np.ndarray, points: np.ndarray, pose: Pose2D, submaps: list[int]) -> int:
        """Add a node.

        Args:
            ranges: shape (num_beams,), float32 [m]: its scan.
            points: shape (n, 2), float32, its hits in the base frame [m].
            pose: of the base, local frame.
            submaps: those that it is integrated into, the newest last.

        Returns:
            Its index.
        """
        first = len(self._points)
        self._ranges.append(ranges)
        self._points.extend(points)
        self._spans.append((first, first + len(points)))
        node = self._poses.append(pose)
        self._home.append(submaps[-1])
        for submap in submaps:
            self._submaps.rows[submap, 1] = node + 1
        return node

    def nodes_of(self, submap: int) -> slice:
        """Return which nodes a submap holds."""
        first, last = self._submaps.rows[submap].tolist()
        return slice(first, last)

    def submap_pose(self, submap: int) -> Pose2D:
        """Return the pose of a submap in the local frame."""
        x, y, _ = self._poses.rows[self._submaps.rows[submap, 0]].tolist()
        return Pose2D(x, y, 0.0)

    @property
    def ranges(self) -> np.ndarray:
        """Shape (num_nodes, num_beams), float32: scans [m]."""
        return self._ranges.rows

    def points(self, node: int) -> np.ndarray:
        """Return the hits of a node, shape (n, 2), float32, base frame [m]."""
        first, last = self._spans.rows[node].tolist()
        return self._points.rows[first:last]

    def render(self, submap: int, resolution: float) -> tuple[np.ndarray, FieldGeometry]:
        """Render the field of a submap; see `render_field`."""
        nodes = self.nodes_of(submap)
        poses = self._poses.rows[nodes] - np.array(self.submap_pose(submap))
        return render_field(Scans(self._points.rows, self._spans.rows[nodes], poses, *self.mount), resolution, MODEL)

    def recent_points(self, node: int, count: int, cell: float, max_range: float) -> np.ndarray:
        """Return the hits of the last nodes up to this one, in its frame, one per cell: shape (n, 2), float32 [m].

        Nodes that odometry does not join with the newest one are left out.
        """
        here = Pose2D(*self._poses.rows[node].tolist())
        parts = [self.points(node)]
        for k in range(max(node - count + 1, self._first_joined), node):
            parts.append(here.between(Pose2D(*self._poses.rows[k].tolist())).transform(self.points(k)))
        points = np.concatenate(parts).astype(np.float32)
        points = points[(points**2).sum(axis=1) < max_range**2]
        cells = np.floor(points / cell).astype(np.int64)
        _, first = np.unique((cells[:, 0] << 32) + cells[:, 1], return_index=True)
        return points[np.sort(first)]
