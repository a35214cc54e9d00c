import dataclasses
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, distance, wrap_angle
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam.key_scans import has_moved
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.branch_and_bound import SearchWindow, angle_step, search
from lidarnaut.envs.slam.matching.fields import Field, Pyramid, build_pyramid, hit_shares, is_accepted
from lidarnaut.envs.slam.matching.gauss_newton import PosePrior, refine
from lidarnaut.envs.slam.matching.score_surface import MAX_SURFACE, match_covariance
from lidarnaut.envs.slam.posegraph import PoseGraph
from lidarnaut.envs.slam.slam_params import GraphSlamParams

from .local_slam import submap_params
from .nodes import NodeStore

HALF_WIDTH, HALF_WIDTH_GROWTH = 0.5, 0.06
"""Half width of a loop-closure search: minimum [m], growth per metre of path between the scans."""
HALF_ANGLE, HALF_ANGLE_GROWTH, MAX_HALF_ANGLE = 0.1, 0.015, 0.6
"""Half angle of a loop-closure search: minimum [rad], growth per metre of path between the scans [rad/m], maximum
[rad]."""
MAX_DISTANCE = 4.0
"""Maximum distance between a scan and a submap for a loop-closure search [m]; more for large search windows."""
MAX_UNCONFIRMED = 0.25
"""Maximum position correction of a loop closure that needs no confirmation [m]."""
CONFIRMATION_NODES, CONFIRMATION_DISTANCE, CONFIRMATION_ANGLE = 25, 0.2, 0.05
"""Maximum difference between two loop closures that confirm each other: nodes, distance [m], angle [rad]."""
SUBMAP_EVERY, MAX_CANDIDATES = 6, 2
"""Minimum number of nodes between loop-closure searches of the same submap, and maximum number of submaps per node."""
MAX_EVALUATIONS, MAX_RENDERED = 20_000, 8
"""Maximum number of branch-and-bound nodes (blocks of poses) scored per search, and of submaps kept in memory."""
NUM_LEVELS = 5
MAX_RANGE, MAX_POINTS = 12.0, 1200
"""Maximum range [m] and maximum number of scan points matched in a loop-closure search."""
SEARCH_SHARE = 0.8
"""Minimum score of a loop closure before Gauss-Newton refinement, divided by the minimum score after it."""
NUM_SKIPPED_SUBMAPS = 2
"""Number of newest finished submaps to skip, because the robot has just left them."""
FIELD_PARAMS: dict[str, Any] = {"num_levels": 1, "skip_exceeding": True, "occupied_prob": 0.9002, "empty_prob": 0.3989}
NO_PRIOR = PosePrior(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Loop(NamedTuple):
    """Loop closure between a graph node (scan) and a submap."""

    node: int
    submap: int
    relative: Pose2D
    """Measured node pose in the submap frame [m, m, rad]."""
    covariance: np.ndarray
    """Covariance of the measured node pose, shape (3, 3), submap frame [m^2, rad^2]."""
    before: Pose2D
    """Node pose before the loop closure, map frame [m, m, rad]."""
    after: Pose2D


def window_size(path_length: float, max_half_width: float) -> tuple[float, float]:
    """Return half width [m] and half angle [rad] of a loop-closure search; both grow with the distance driven [m]."""
    half_angle = min(HALF_ANGLE + HALF_ANGLE_GROWTH * path_length, MAX_HALF_ANGLE)
    return min(HALF_WIDTH + HALF_WIDTH_GROWTH * path_length, max_half_width), half_angle


@njit(cache=True, error_model="numpy")
def path_lengths(constraints, home, travelled, source):
    """Return lengths of shortest paths in the graph from a submap to all submaps, shape (num_submaps,), float64 [m].

    Successive submaps are connected by the travelled distance; loop closures have length 0. `home`: index of each
    node's newest submap. `travelled`: distance travelled until the start of each submap [m].
    """
    num_submaps = travelled.shape[0]
    lengths = np.abs(travelled - travelled[source])
    changed = True
    while changed:
        changed = False
        for k in range(constraints.node.shape[0]):
            if constraints.is_loop[k] and constraints.is_active[k]:
                a, b = home[constraints.node[k]], constraints.submap[k]
                least = min(lengths[a], lengths[b])
                if lengths[a] > least or lengths[b] > least:
                    lengths[a] = lengths[b] = least
                    changed = True
        if changed:
            for k in range(1, num_submaps):
                lengths[k] = min(lengths[k], lengths[k - 1] + travelled[k] - travelled[k - 1])
            for k in range(num_submaps - 1, 0, -1):
                lengths[k - 1] = min(lengths[k - 1], lengths[k] + travelled[k] - travelled[k - 1])
    return lengths


def least_distances(nodes: np.ndarray, spans: np.ndarray, node: int) -> np.ndarray:
    """Return the distance from a graph node to the nearest node of each submap [m].

    `nodes`: node poses, shape (num_nodes, 3). `spans`: index of each submap's first node, and index after the last,
    shape (num_submaps, 2).
    """
    far = np.hypot(*(nodes[:, :2] - nodes[node, :2]).T)
    return np.minimum.reduceat(np.append(far, np.inf), spans.ravel())[::2]


class LoopSearch:
    """Queue of loop-closure searches, each between a scan and a submap."""

    def __init__(self, params: GraphSlamParams, lidar: LidarParams, nodes: NodeStore, graph: PoseGraph) -> None:
        self._params, self._lidar, self._nodes, self._graph = params, lidar, nodes, graph
        self._field_params = dataclasses.replace(submap_params(params, lidar), **FIELD_PARAMS)
        self._searched: dict[int, int] = {}
        self.queue: deque[tuple[int, int, tuple[float, float]]] = deque()
        """Node, submap and window of each waiting search."""
        self._kept: dict[int, tuple[Field, Pyramid]] = {}

    def add_candidates(self, node: int, num_finished: int) -> None:
        """Queue loop-closure searches between a node and nearby submaps. `num_finished`: number of finished submaps."""
        params, nodes, count = self._params, self._nodes, num_finished - NUM_SKIPPED_SUBMAPS
        if count <= 0:
            return
        arrays, home = self._graph.arrays, nodes.home.rows
        lengths = path_lengths(arrays.constraints, home, nodes.travelled.rows, home[node])
        near = []
        distances = least_distances(arrays.nodes, nodes.spans.rows[:count], node)
        farthest = MAX_DISTANCE + 0.5 * params.linear_search_window
        for submap in np.flatnonzero(distances <= farthest).tolist():
            if node - self._searched.get(submap, -SUBMAP_EVERY) < SUBMAP_EVERY:
                continue
            window, least = window_size(float(lengths[submap]), params.linear_search_window), float(distances[submap])
            if least <= MAX_DISTANCE + 0.5 * window[0]:
                near.append((least, submap, window))
        for _, submap, window in sorted(near)[:MAX_CANDIDATES]:
            self._searched[submap] = node
            self.queue.append((node, submap, window))

    def match(self, node: int, submap: int, window: tuple[float, float]) -> Loop | None:
        """Match recent scans of a node to a submap; return the loop closure if accepted.

        `window`: half width [m] and half angle [rad].
        """
        params, loops = self._params, self._params.loops
        points = self._nodes.recent_points(node, params.loop_scans, MAX_RANGE, MAX_POINTS)
        if len(points) == 0:
            return None
        field, pyramid = self._rendered(submap)
        arrays = self._graph.arrays
        frame, before = Pose2D(*arrays.submaps[submap].tolist()), Pose2D(*arrays.nodes[node].tolist())
        steps = SearchWindow(*window, angle_step(points, params.resolution))
        limits = (SEARCH_SHARE * loops.min_score, MAX_EVALUATIONS)
        found = search(pyramid, points, frame.between(before), steps, *limits).pose
        if found is None:
            return None
        pose = refine_in_field(field, points, found, params.iterations)
        if not is_accepted(hit_shares(field, points, pose), loops):
            return None
        covariance = match_covariance(pyramid, points, pose, min(MAX_SURFACE, window[0]))
        return Loop(node, submap, pose, covariance, before, frame.compose(pose))

    def _rendered(self, submap: int) -> tuple[Field, Pyramid]:
        kept = self._kept.pop(submap, None)
        if kept is None:
            map = LogOddsMap(self._field_params, self._lidar)
            map.integrate_all(*self._nodes.submap_scans(submap))
            field = Field.of(map.grid)
            kept = field, build_pyramid(field, NUM_LEVELS, max(self._params.linear_search_window, MAX_SURFACE))
        self._kept[submap] = kept
        if len(self._kept) > MAX_RENDERED:
            del self._kept[next(iter(self._kept))]
        return kept


def refine_in_field(field: Field, points: np.ndarray, pose: Pose2D, iterations: int) -> Pose2D:
    """Refine a pose on an occupancy grid by Gauss-Newton scan matching without prior.

    `points`: scan points, shape (n, 2), float32, base frame [m].
    """
    x, y, resolution = field[1:]
    start = (pose.x - x) / resolution, (pose.y - y) / resolution, pose.theta
    cells = np.ascontiguousarray(points.T / np.float32(resolution))
    over = ((field.occupancy,), 1, cells, cells.shape[1])
    col, row, theta, _ = refine(*over, start, NO_PRIOR, iterations, iterations)
    return Pose2D(col * resolution + x, row * resolution + y, wrap_angle(theta))


class Confirmation:
    """Filter that accepts loop closures with large position corrections only in agreeing pairs."""

    def __init__(self) -> None:
        self._pending: list[Loop] = []

    def add(self, loop: Loop) -> list[Loop]:
        """Add a loop closure; return those accepted now: none, only `loop`, or also an earlier one that agrees."""
        self._pending = [each for each in self._pending if loop.node - each.node <= CONFIRMATION_NODES]
        if distance(loop.after.x - loop.before.x, loop.after.y - loop.before.y) <= MAX_UNCONFIRMED:
            return [loop]
        for each in self._pending:
            # Both closures agree on the pose of the second node.
            expected = each.after.compose(each.before.between(loop.before))
            limits = (CONFIRMATION_DISTANCE, CONFIRMATION_ANGLE)
            if each.node != loop.node and not has_moved(*expected, *loop.after, *limits):
                self._pending.remove(each)
                return [each, loop]
        self._pending.append(loop)
        return []
