"""Searching loop closures of nodes with finished submaps."""

from collections import deque

import numpy as np

from envs.geometry import Pose2D, wrap_angle
from envs.slam.matching.branch_and_bound import SearchLimits, SearchWindow, angle_step, search
from envs.slam.matching.gauss_newton import Prior, refine
from envs.slam.matching.pyramid import Pyramid, build_pyramid
from envs.slam.matching.score_surface import match_covariance
from envs.slam.matching.submap_field import UNKNOWN_PERCENT, FieldGeometry
from envs.slam.posegraph import PoseGraph
from envs.slam.posegraph.distances import least_distances, path_lengths

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
Field = tuple[np.ndarray, FieldGeometry]
"""Occupancy in percent, shape (height, width), uint8, and where it lies."""
NO_PRIOR = Prior(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class LoopSearch:
    """Searches loop closures, one submap per call, so that the work of a scan is bounded."""

    def __init__(self, params: GraphSlamParams, nodes: NodeStore, graph: PoseGraph) -> None:
        """Search in the submaps of `nodes`, at poses of `graph`."""
        self._params, self._nodes, self._graph = params, nodes, graph
        self._searched: dict[int, int] = {}
        self._queue: deque[tuple[int, int, tuple[float, float]]] = deque()
        self._kept: dict[int, tuple[Field, Pyramid]] = {}
        self.num_searches = 0
        """Number of branch-and-bound searches so far."""

    def add_candidates(self, node: int, num_finished: int) -> None:
        """Queue searches of a node in those of the first `num_finished` submaps that are near."""
        for submap, window in self._candidates(node, num_finished - NEWEST):
            self._searched[submap] = node
            self._queue.append((node, submap, window))

    def search_next(self) -> Loop | None:
        """Do the search that has waited longest, if there is one; return the loop closure if it passes the tests."""
        return self.match(*self._queue.popleft()) if self._queue else None

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
        distances = least_distances(arrays.nodes, nodes.spans[:count], node)
        farthest = params.loops.max_distance + 0.5 * params.loops.max_half_width
        for submap in np.flatnonzero(distances <= farthest).tolist():
            if node - self._searched.get(submap, -params.submap_every) < params.submap_every:
                continue
            window, least = search_window(float(lengths[submap]), params.loops), float(distances[submap])
            if least <= params.loops.max_distance + 0.5 * window[0]:
                near.append((least, submap, window))
        return [(submap, window) for _, submap, window in sorted(near)[: params.max_candidates]]

    def match(self, node: int, submap: int, window: tuple[float, float]) -> Loop | None:
        """Search a node in a submap: half width [m] and half angle [rad] of the window around where it should be."""
        params, loops = self._params, self._params.loops
        points = self._nodes.recent_points(node, params.loop_scans, POINT_CELL, POINT_RANGE)
        points = np.ascontiguousarray(points[:: len(points) // MAX_POINTS + 1])
        if len(points) == 0:
            return None
        self.num_searches += 1
        field, pyramid = self._rendered(submap)
        arrays = self._graph.arrays
        frame, before = Pose2D(*arrays.submaps[submap].tolist()), Pose2D(*arrays.nodes[node].tolist())
        limits = SearchLimits(SEARCH_SHARE * loops.min_score, params.max_evaluations)
        steps = SearchWindow(*window, angle_step(points, params.resolution))
        result = search(pyramid, points, frame.between(before), steps, limits)
        if not result.found:
            return None
        pose = refine_in_field(field, points, Pose2D(result.x, result.y, result.theta), params.iterations)
        if not is_accepted(hit_shares(*field, points, pose), loops):
            return None
        surface = params.surface._replace(half_width=min(params.surface.half_width, window[0]))
        covariance = match_covariance(pyramid, points, pose, surface)
        return Loop(node, submap, pose, covariance, before, frame.compose(pose))

    def _rendered(self, submap: int) -> tuple[Field, Pyramid]:
        """Return the field of a finished submap, and the pyramid; those used last are kept."""
        params = self._params
        kept = self._kept.pop(submap, None)
        if kept is None:
            field = self._nodes.render(submap, params.resolution)
            reach = max(params.loops.max_half_width, params.surface.half_width)
            kept = field, build_pyramid(*field, NUM_LEVELS, reach, UNKNOWN_PERCENT)
        self._kept[submap] = kept
        if len(self._kept) > params.max_rendered:
            del self._kept[next(iter(self._kept))]
        return kept


def refine_in_field(field: Field, points: np.ndarray, pose: Pose2D, iterations: int) -> Pose2D:
    """Return the pose to which Gauss-Newton steps lead, without a prior.

    Args:
        field: of a submap.
        points: shape (n, 2), float32, hits in the base frame [m].
        pose: to start from, submap frame.
        iterations: greatest number of steps.
    """
    occupancy, (x, y, resolution) = field
    start = (pose.x - x) / resolution, (pose.y - y) / resolution, pose.theta
    cells = np.ascontiguousarray(points.T / np.float32(resolution))
    col, row, theta, _ = refine((occupancy,), cells, cells.shape[1], start, NO_PRIOR, iterations, iterations)
    return Pose2D(col * resolution + x, row * resolution + y, wrap_angle(theta))
