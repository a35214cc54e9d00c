"""Searching loop closures of nodes with finished submaps."""

from collections import deque

import numpy as np

from envs.geometry import Pose2D
from envs.slam.matching.branch_and_bound import SearchLimits, SearchWindow, angle_step, search
from envs.slam.matching.pyramid import Pyramid, build_pyramid
from envs.slam.matching.score_surface import match_covariance
from envs.slam.matching.submap_field import UNKNOWN_PERCENT
from envs.slam.posegraph import PoseGraph
from envs.slam.posegraph.distances import least_distances, path_lengths

from .local_slam import Field, Matcher
from .loop_closure import Loop, hit_shares, is_accepted, search_window
from .nodes import NodeStore
from .params import GraphSlamParams

NUM_LEVELS = 5
"""Levels of the pyramid: the top one holds maxima over 16 cells."""
POINT_CELL, POINT_RANGE, MAX_POINTS = 0.1, 12.0, 1200
"""One point per cell of this side [m], up to this range [m], and no more than so many, are matched."""
SEARCH_SHARE = 0.8
"""Share of the least score from which on the search finds poses, before they are refined."""
NEWEST = 2
"""Finished submaps that are not searched: the robot has not left them for long."""


class LoopSearch:
    """Searches loop closures, one submap per call, so that the work of a scan is bounded."""

    def __init__(self, params: GraphSlamParams, matcher: Matcher, nodes: NodeStore, graph: PoseGraph) -> None:
        """Search in the submaps of `nodes`, at poses of `graph`."""
        self._params, self._matcher, self._nodes, self._graph = params, matcher, nodes, graph
        self._searched: dict[int, int] = {}
        self._queue: deque[tuple[int, int, tuple[float, float]]] = deque()
        self._kept: dict[int, tuple[Field, Field, Pyramid]] = {}
        self.num_searches = 0
        """Number of branch-and-bound searches so far."""

    def add_candidates(self, node: int, num_finished: int) -> None:
        """Queue searches of a node in those of the first `num_finished` submaps that are near."""
        for submap, window in self._candidates(node, num_finished - NEWEST):
            self._searched[submap] = node
            self._queue.append((node, submap, window))

    def search_next(self) -> Loop | None:
        """Do the search that has waited longest, if there is one; return the loop closure if it passes the tests."""
        return self._match(*self._queue.popleft()) if self._queue else None

    @property
    def num_waiting(self) -> int:
        """Number of searches that wait."""
        return len(self._queue)

    def _candidates(self, node: int, count: int) -> list[tuple[int, tuple[float, float]]]:
        """Return the nearest of the first `count` submaps that may be searched, with their windows."""
        params, nodes = self._params, self._nodes
        if count <= 0:
            return []
        arrays = self._graph.arrays
        lengths = path_lengths(arrays.constraints, nodes.home, nodes.travelled, nodes.home[node])
        near = []
        for submap, least in enumerate(least_distances(arrays.nodes, nodes.spans[:count], node).tolist()):
            if node - self._searched.get(submap, -params.submap_every) < params.submap_every:
                continue
            window = search_window(float(lengths[submap]), params.loops)
            if least <= params.loops.max_distance + 0.5 * window[0]:
                near.append((least, submap, window))
        return [(submap, window) for _, submap, window in sorted(near)[: params.max_candidates]]

    def _match(self, node: int, submap: int, window: tuple[float, float]) -> Loop | None:
        params, loops = self._params, self._params.loops
        points = self._nodes.recent_points(node, params.loop_scans, POINT_CELL, POINT_RANGE)
        points = np.ascontiguousarray(points[:: len(points) // MAX_POINTS + 1])
        if len(points) == 0:
            return None
        self.num_searches += 1
        coarse, fine, pyramid = self._rendered(submap)
        arrays = self._graph.arrays
        frame, before = Pose2D(*arrays.submaps[submap].tolist()), Pose2D(*arrays.nodes[node].tolist())
        limits = SearchLimits(SEARCH_SHARE * loops.min_score, params.max_evaluations)
        steps = SearchWindow(*window, angle_step(points, params.resolution))
        result = search(pyramid, points, frame.between(before), steps, limits)
        if not result.found:
            return None
        rough = Pose2D(result.x, result.y, result.theta)
        pose = self._matcher([coarse, fine], points, rough, np.zeros((3, 3))).pose
        if not is_accepted(hit_shares(*fine, points, pose), loops):
            return None
        surface = params.surface._replace(half_width=min(params.surface.half_width, window[0]))
        covariance = match_covariance(pyramid, points, pose, surface)
        return Loop(node, submap, pose, covariance, before, frame.compose(pose))

    def _rendered(self, submap: int) -> tuple[Field, Field, Pyramid]:
        """Return coarse and fine field of a finished submap, and the pyramid; those used last are kept."""
        params = self._params
        kept = self._kept.pop(submap, None)
        if kept is None:
            coarse, fine = (self._nodes.render(submap, factor * params.resolution) for factor in (2.0, 1.0))
            reach = max(params.loops.max_half_width, params.surface.half_width)
            kept = coarse, fine, build_pyramid(*fine, NUM_LEVELS, reach, UNKNOWN_PERCENT)
        self._kept[submap] = kept
        if len(self._kept) > params.max_rendered:
            del self._kept[next(iter(self._kept))]
        return kept
