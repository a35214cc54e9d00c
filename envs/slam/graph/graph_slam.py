"""Graph SLAM: local SLAM builds submaps, loop closures and a pose graph correct where they lie.

Hess et al., Real-time loop closure in 2D lidar SLAM, 2016. Local SLAM goes on undisturbed by corrections: the pose in
the map frame is its pose, moved by the correction of the newest submap.
"""

import numpy as np

from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.robots import LidarParams
from envs.slam.posegraph import PoseGraph, drop_outliers, optimise_step
from envs.slam.scans import ScanGeometry, check_scan, project_hits

from .local_slam import LocalSlam, Matcher
from .loop_closure import Confirmation
from .loop_search import LoopSearch
from .nodes import NodeStore
from .params import GraphSlamParams


class GraphTracker:
    """Estimates the trajectory of a robot by graph SLAM; maps are rendered from its nodes."""

    def __init__(self, lidar: LidarParams, params: GraphSlamParams, matcher: Matcher) -> None:
        """Build the tracker for one lidar, with a scan matcher for submaps."""
        self.params = params
        self._lidar, self._matcher = lidar, matcher
        self._geometry = ScanGeometry.of(lidar, 1.0)
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self.reset()

    def reset(self) -> None:
        """Start at the origin of the map frame, with nothing known."""
        self.graph = PoseGraph()
        """Nodes and submaps in the map frame."""
        self.nodes = NodeStore(self._geometry.mount_x, self._geometry.mount_y)
        """Scans and poses in the local frame."""
        self.local = LocalSlam(self.params, self._matcher, self.nodes)
        self.search = LoopSearch(self.params, self._matcher, self.nodes, self.graph)
        self._confirmation = Confirmation(self.params.loops)
        self._correction = Pose2D(0.0, 0.0, 0.0)
        self._loop_nodes = self._iterations = 0
        self.num_corrections = 0
        """Number of optimisations so far."""

    @property
    def pose(self) -> Pose2D:
        """Of the base, map frame."""
        return self._correction.compose(self.local.pose)

    def update(self, ranges: np.ndarray, motion: Pose2D) -> Pose2D:
        """Process one scan; return the pose in the map frame.

        The work of a scan is bounded: at most one search for a loop closure and one iteration of an optimisation.

        Args:
            ranges: shape (num_beams,), float32 [m]: +inf for no return, NaN for a beam to ignore.
            motion: pose of the base now, as odometry sees it from the base at the previous scan.

        Raises:
            ValueError: if the scan has another number of beams, or the motion is not finite.
        """
        ranges = check_scan(ranges, motion, self._lidar)
        count = project_hits(ranges, self._geometry, self._points)
        node = self.local.update(np.ascontiguousarray(self._points[:, :count].T), motion)
        if node is not None:
            self._add_node(node)
            if node % self.params.loop_every == 0:
                self.search.add_candidates(node, self.nodes.num_submaps - len(self.local.active))
        self._close_loop()
        if self._iterations:
            self._optimise_once()
        return self.pose

    def finish(self) -> None:
        """Do the searches that wait, and optimise to the end, with all loop closures."""
        while self.search.num_waiting:
            self._close_loop()
        self._iterations = self._iterations or self.params.max_iterations
        while self._iterations:
            self._optimise_once()

    def _add_node(self, node: int) -> None:
        """Add a node of local SLAM, its constraints, and a submap if one starts with it."""
        active = self.local.active
        known = active[0] if active[0] < self.graph.num_submaps else None
        pose = self._correction.compose(self.local.pose)
        if known is not None:
            frame = Pose2D(*self.graph.arrays.submaps[known].tolist())
            pose = frame.compose(self.nodes.submap_pose(known).between(self.local.pose))
        self.graph.add_node(pose)
        for submap in active:
            relative = self.nodes.submap_pose(submap).between(self.local.pose)
            if submap == self.graph.num_submaps:
                self.graph.add_submap(pose.compose(relative.inverse()))
            self.graph.add_constraint(node, submap, relative, self.local.covariance(submap))

    def _close_loop(self) -> None:
        """Do one search for a loop closure, and start an optimisation when it is due."""
        loop = self.search.search_next()
        added = [] if loop is None else self._confirmation.add(loop)
        for loop in added:
            self.graph.add_constraint(loop.node, loop.submap, loop.relative, loop.covariance, is_loop=True)
        self._loop_nodes += len(added) > 0
        largest = max(
            (distance(each.after.x - each.before.x, each.after.y - each.before.y) for each in added), default=0.0
        )
        if self._loop_nodes >= self.params.optimise_every or largest > self.params.urgent_correction:
            self._iterations, self._loop_nodes = self.params.max_iterations, 0

    def _optimise_once(self) -> None:
        """Do one iteration; after the last one, correct the pose."""
        params, arrays = self.params, self.graph.arrays
        change = optimise_step(arrays, params.phi)
        self._iterations -= 1
        if change < params.tolerance:
            self._iterations = 0
        if self._iterations == 0:
            drop_outliers(arrays, params.max_chi2)
            newest = self.graph.num_submaps - 1
            frame = Pose2D(*arrays.submaps[newest].tolist())
            self._correction = frame.compose(self.nodes.submap_pose(newest).inverse())
            self.num_corrections += 1
