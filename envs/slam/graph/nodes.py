"""What is kept of nodes and submaps beside the pose graph: scans, and poses in the local frame."""

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.key_scans import KeyScans
from envs.slam.posegraph import GrowingArray


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
