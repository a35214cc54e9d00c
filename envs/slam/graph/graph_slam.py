import math
from functools import cache

import numpy as np

from lidarnaut.envs.estimation import Belief, Correction, MapUpdate
from lidarnaut.envs.geometry import ORIGIN, GrowingArray, Pose2D, distance
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam.hector import Hector
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.fields import LEAST_MAP_SHARE, fits_map
from lidarnaut.envs.slam.posegraph import PoseGraph, PoseGraphView, drop_outliers, optimise_step
from lidarnaut.envs.slam.relocalization import FOUND_STD
from lidarnaut.envs.slam.slam_params import GraphSlamParams

from .local_slam import LocalSlam
from .loop_search import NUM_SKIPPED_SUBMAPS, Confirmation, LoopSearch
from .nodes import MapRendering, NodeStore, any_pose_moved, refine_poses

PHI, MAX_CHI2 = 9.0, 54.0
"""Chi-squares above which loop-closure constraints get a lower weight, and are excluded from the pose graph."""
FINAL_ITERATIONS = 10


class GraphSlam(Hector):
    """SLAM with submaps, loop closures and a pose graph (Hess et al., Real-time loop closure in 2D lidar SLAM, 2016).

    A scan is matched to the whole map for the robot pose, and to submaps (maps of some tens of scans, without
    loop-closure corrections) for constraints of the graph. Work per matched scan is bounded: one loop-closure search,
    and one optimisation iteration or part of the corrected map. Pose and map change together when this map is complete.

    `belief.is_lost` is set after consecutive scans that do not fit the map, or at high position uncertainty. A lost
    robot adds no nodes; after relocalization, the next node is constrained to the nearest one. `belief.covariance` is
    relative to the current map.
    """

    shares_maps = False
    params: GraphSlamParams
    map: LogOddsMap

    def __init__(self, lidar: LidarParams, params: GraphSlamParams) -> None:
        load_kernels()
        super().__init__(lidar, params)

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: LogOddsMap | None = None) -> Belief:
        self.graph = PoseGraph()
        self.nodes = NodeStore(self._lidar)
        self.local = LocalSlam(self.params, self._lidar, self.nodes)
        self.search = LoopSearch(self.params, self._lidar, self.nodes, self.graph)
        self._confirmation = Confirmation()
        self._correction = self._graph_correction = pose
        self._mapped = GrowingArray((3,), np.float64, 256)
        self._rendering: MapRendering | None = None
        self._loop_nodes = self._iterations = self._last_optimised = 0
        self._is_urgent = False
        return super().reset(rng, pose, map)

    @property
    def loop_closures(self) -> int:  # type: ignore[override]
        """Number of loop closures in the pose graph, without outliers."""
        constraints = self.graph.arrays.constraints
        return int(np.count_nonzero(constraints.is_loop & constraints.is_active))

    @property
    def pose_graph(self) -> PoseGraphView:
        """Current pose graph; valid until the next scan."""
        return PoseGraphView(self.graph.arrays)

    @property
    def anchor(self) -> tuple[int, Pose2D] | None:
        """Robot pose relative to the newest graph node (scan in the map); None before the first."""
        if len(self.nodes) == 0:
            return None
        node = len(self.nodes) - 1
        pose = self._correction.compose(Pose2D(*self.nodes.poses[node].tolist()))
        return node, pose.between(self.belief.pose)

    def process_key_scan(self, ranges: np.ndarray, predicted: Pose2D) -> Belief:
        belief = super().process_key_scan(ranges, predicted)
        belief.path = None
        if self._monitor.has_mismatch:
            # Relocalization needs an unchanged map.
            return belief
        self._close_loop()
        if self._rendering is not None:
            if self._rendering.add(self.nodes, self.graph.arrays.nodes, self.params.cells_per_scan):
                self._replace_map(self._rendering.map)
        elif self._iterations:
            self._optimise_once()
        return belief

    def finish(self) -> None:
        """Complete loop-closure searches, optimisation and corrected map; write node poses to `belief.path`."""
        while self.search.queue:
            self._close_loop()
        self._iterations = FINAL_ITERATIONS
        while self._iterations:
            self._optimise_once()
        poses = self.graph.arrays.nodes
        poses[:] = refine_poses(self.params, self._lidar, self.nodes, poses)
        if len(poses):
            local = Pose2D(*self.nodes.poses[-1].tolist())
            self._graph_correction = Pose2D(*poses[-1].tolist()).compose(local.inverse())
        self._replace_map(MapRendering(self.params, self._lidar).add_all(self.nodes, poses))

    def match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        before = self._last_matched_pose() or self._correction
        fits = self.local.match(ranges, before.between(predicted), self.slip)
        if self.last_key_pose is None:
            return predicted, 1.0
        by_local_slam = self._correction.compose(self.local.pose)
        # Local SLAM predicts better than poor odometry, but its errors add up; good odometry predicts better.
        match = self._match_map(ranges, by_local_slam if self.params.match_every_scan else predicted)
        # A submap bends less than the map, but lacks older observations.
        points = self._points[:, : match.num_hits]
        if fits_map(self.map.grid, points, (match.x, match.y, match.theta), LEAST_MAP_SHARE) is False:
            fits = False
        pose = Pose2D(match.x, match.y, match.theta) if match.fits else by_local_slam
        fallback_pose = self._update_lost(ranges, predicted, pose, fits)
        if fallback_pose is not None:
            in_local_frame = self._correction.inverse().compose(fallback_pose)
            if self._monitor.is_found:
                self.local.relocate(in_local_frame)
            self.local.pose = in_local_frame
            return fallback_pose, None
        self._correction = pose.compose(self.local.pose.inverse())
        return pose, 1.0

    def _integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        is_relocalized = len(self.nodes) > 0 and not self.local.active
        node = self.local.add_node(ranges)
        local, correction = self.local, self._graph_correction
        self.graph.add_node(correction.compose(local.pose))
        for submap in local.active:
            frame = self.nodes.submap_pose(submap)
            if submap == self.graph.num_submaps:
                self.graph.add_submap(correction.compose(frame))
            self.graph.add_constraint(node, submap, frame.between(local.pose), local.constraint_covariance(submap))
        if is_relocalized:
            self._relate(node, pose)
        self._mapped.append(pose)
        if node % self.params.loop_every == 0:
            self.search.add_candidates(node, len(self.nodes.spans) - len(self.local.active))
        return self.map.integrate(ranges, pose)

    def _relate(self, node: int, pose: Pose2D) -> None:
        mapped, arrays = self._mapped.rows, self.graph.arrays
        near = int(np.argmin(np.hypot(*(mapped[:, :2] - pose[:2]).T)))
        submap = int(self.nodes.home.rows[near])
        frame, there = Pose2D(*arrays.submaps[submap].tolist()), Pose2D(*arrays.nodes[near].tolist())
        by_graph = there.compose(Pose2D(*mapped[near].tolist()).between(pose))
        self.graph.add_constraint(node, submap, frame.between(by_graph), np.diag(FOUND_STD) ** 2, is_loop=True)

    def _close_loop(self) -> None:
        loop = self.search.match(*self.search.queue.popleft()) if self.search.queue else None
        added = [] if loop is None else self._confirmation.add(loop)
        self._loop_nodes += len(added) > 0
        for loop in added:
            self.graph.add_constraint(loop.node, loop.submap, loop.relative, loop.covariance, is_loop=True)
            moved = distance(loop.after.x - loop.before.x, loop.after.y - loop.before.y)
            self._is_urgent |= moved > self.params.urgent_correction
        params, count = self.params, len(self.nodes)
        is_long = self._loop_nodes > 0 and count - self._last_optimised >= (params.optimise_nodes or math.inf)
        is_due = self._loop_nodes >= params.optimise_every or is_long or self._is_urgent
        if is_due and self._rendering is None and not self._iterations:
            self._iterations, self._loop_nodes, self._is_urgent = params.max_iterations, 0, False
            self._last_optimised = count

    def _optimise_once(self) -> None:
        params, arrays = self.params, self.graph.arrays
        change = optimise_step(arrays, PHI)
        self._iterations -= 1
        if change < params.tolerance:
            self._iterations = 0
        if self._iterations or self.graph.num_submaps == 0:
            return
        drop_outliers(arrays, MAX_CHI2)
        newest = self.graph.num_submaps - 1
        frame = Pose2D(*arrays.submaps[newest].tolist())
        self._graph_correction = frame.compose(self.nodes.submap_pose(newest).inverse())
        if any_pose_moved(self._mapped.rows, arrays.nodes, params.redraw_distance, params.redraw_angle):
            self._rendering = MapRendering(params, self._lidar)

    def _replace_map(self, map: LogOddsMap) -> None:
        after = self.graph.arrays.nodes.copy()
        self.map.take_cells(map)
        self.belief.update = self.map.redrawn(Correction(self._mapped.rows.copy(), after))
        self.belief.path = after
        self._mapped.rows[:] = after
        self._rendering = None
        moved = self._graph_correction.compose(self._correction.inverse())
        self.belief.pose = moved.compose(self.belief.pose)
        if self.last_key_pose is not None:
            self.last_key_pose = moved.compose(self.last_key_pose)
        self._correction = self._graph_correction


@cache
def load_kernels() -> None:
    """Compile the loop-closure kernels once per process."""
    lidar, params = LidarParams(num_beams=16, range_max=2.0), GraphSlamParams(loop_scans=2)
    nodes, graph = NodeStore(lidar), PoseGraph()
    local, search = LocalSlam(params, lidar, nodes), LoopSearch(params, lidar, nodes, graph)
    ranges = np.linspace(0.5, 1.5, 16, dtype=np.float32)
    for node in range(3):
        local.match(ranges, ORIGIN)
        local.add_node(ranges)
        graph.add_node(local.pose)
        if node == 0:
            graph.add_submap(ORIGIN)
        graph.add_constraint(node, 0, local.pose, local.constraint_covariance(0), is_loop=node == 2)
    search.add_candidates(2, 1 + NUM_SKIPPED_SUBMAPS)
    search.match(2, 0, (0.2, 0.1))
    optimise_step(graph.arrays, PHI)
    drop_outliers(graph.arrays, MAX_CHI2)
