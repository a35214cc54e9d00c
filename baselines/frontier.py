"""Seed 3's frontier explorer: dilation, DBSCAN, clearance filter, utility, valid paths, blacklist, progress.

Where the seed leaves something open, the program that it describes decides: DBSCAN's `min_samples` is the least
frontier size, the radius of the information gain is scaled by the map's diagonal over 20 m (at most doubled), and a
blacklist that covers too much forgets its oldest two thirds. Detection and DBSCAN are kernels of `envs.navigation`
here, equal to SciPy's and scikit-learn's cell by cell. Whether a valid path leads to a candidate, which the seed asks
Nav2 for one by one, the travel field tells for all at once. A robot that is stuck (`NavigatorParams.stuck_distance`)
gives its goal up: that cancels the way there, blacklists it, and the next goal is chosen at once. Two things had to be
settled anew:

- *Share explored.* The seed divides the free cells by all cells of the map, and its map ends where observations end.
  Ours grows ahead of them, so the rectangle around everything observed takes the place of the map.
- *Starvation.* The seed's distances suit a warehouse; in a small place nothing passes its filters. When no candidate is
  left, the filters are relaxed step by step (`RELAXED`), and only when the last step finds nothing either, exploration
  ends.
"""

import logging
import math
from dataclasses import dataclass, replace

import numpy as np

from baselines.goal_explorer import Goal, GoalExplorer
from baselines.navigator import Navigator
from baselines.survey import Survey
from baselines.viewpoints import find_viewpoint
from envs.geometry import OccupancyGrid
from envs.geometry.distance_transform import squared_distances
from envs.navigation import count_unknown, dbscan
from envs.navigation.frontiers import FREE_BELOW
from envs.robots import RobotParams
from envs.slam import Belief

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrontierParams:
    """Defaults: `exploration_params.yaml` of seed 3, section 3.3.1."""

    cluster_tolerance: float = 0.5
    """Distance up to which DBSCAN counts frontier cells as neighbours [m]."""
    min_frontier_size: int = 8
    """Frontier cells that make a cluster dense."""
    min_frontier_size_final: int = 3
    """The same once `adaptive_threshold` is passed."""
    adaptive_threshold: float = 0.7
    """Share explored from which small frontiers count too."""
    obstacle_clearance: float = 0.5
    """Least distance of a cluster's centroid from obstacles [m]."""
    obstacle_above: int = 50
    """Occupancy above which a cell is an obstacle for the clearance [percent]."""
    information_gain_radius: float = 2.0
    """Radius around a centroid in which unknown cells are counted [m]."""
    scale_radius_with_map: bool = True
    """Whether that radius is multiplied by the map's diagonal over 20 m, at most by 2."""
    min_goal_distance: float = 1.2
    """Least distance of a goal from the robot [m]."""
    goal_tolerance: float = 0.3
    """How far from a centroid the robot may stand to look at it (planner's tolerance, section 3.3.2) [m]."""
    blacklist_radius: float = 1.2
    """Goals this near to one that failed are left out [m]."""
    max_blacklist_size: int = 25
    """Failed goals that are remembered."""

    def __post_init__(self) -> None:
        if not 1 <= self.min_frontier_size_final <= self.min_frontier_size:
            sizes = f"{self.min_frontier_size_final} for {self.min_frontier_size}"
            raise ValueError(f"min_frontier_size_final must lie in [1, min_frontier_size], got {sizes}")
        if not 0 <= self.adaptive_threshold <= 1:
            raise ValueError(f"adaptive_threshold must lie in [0, 1], got {self.adaptive_threshold}")
        if not 0 <= self.obstacle_above < 100:
            raise ValueError(f"obstacle_above must lie in [0, 100), got {self.obstacle_above}")
        for name in ("cluster_tolerance", "information_gain_radius"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("obstacle_clearance", "min_goal_distance", "goal_tolerance", "blacklist_radius"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.max_blacklist_size < 1:
            raise ValueError(f"max_blacklist_size must be at least 1, got {self.max_blacklist_size}")

    def relaxed(self, step: int) -> "FrontierParams":
        """Return the params after relaxation step 0 (none) to `RELAXED`."""
        params = self
        if step >= 1:
            params = replace(params, min_frontier_size=params.min_frontier_size_final)
        if step >= 2:
            params = replace(params, obstacle_clearance=0.0)
        if step >= 3:
            params = replace(params, min_goal_distance=0.0)
        if step >= 4:
            params = replace(params, goal_tolerance=1.0)
        if step >= 5:
            params = replace(params, blacklist_radius=0.0)
        return params


RELAXED = 5
"""Relaxation steps, in this order: clusters of the final size; no clearance beyond the robot's footprint; goals near
the robot; frontiers seen from up to a metre away; goals that failed before."""


@dataclass(frozen=True, slots=True, eq=False)
class FrontierStatus:
    """How far the exploration has come (section 3.4.7)."""

    explored_share: float
    """Free cells over all cells of the rectangle around everything observed."""
    goal: tuple[float, float] | None
    """The frontier that the robot is going to see (x, y), map frame [m]; None without one."""
    candidates: np.ndarray
    """Centroids that the last choice was made from, best first, shape (n, 2), map frame [m]."""
    relaxation: int
    """Relaxation step of the last choice, from 0 to `RELAXED`."""
    blacklist_size: int
    """Failed goals that are remembered."""


class FrontierExplorer(GoalExplorer):
    """Goes where the information gain over the distance is greatest."""

    def __init__(self, params: FrontierParams = FrontierParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._blacklist: list[tuple[float, float]] = []
        self._explored_share = 0.0
        self._candidates = np.empty((0, 2))
        self._relaxation = 0

    @property
    def status(self) -> FrontierStatus:
        """Where the exploration stands; of the last look at the map."""
        goal = None if self._goal is None else self._goal.frontier
        return FrontierStatus(
            self._explored_share, goal, self._candidates, self._relaxation, blacklist_size=len(self._blacklist)
        )

    def _consider(self, navigator: Navigator, belief: Belief) -> None:
        goal = self._goal
        super()._consider(navigator, belief)
        if self._goal is not goal:
            status = self.status
            LOGGER.info(
                "%.0f %% explored, %s, %d candidates at relaxation %d, %d blacklisted",
                100.0 * status.explored_share,
                "no goal" if status.goal is None else "goal ({:.2f}, {:.2f})".format(*status.goal),
                len(status.candidates),
                status.relaxation,
                status.blacklist_size,
            )

    def _survey(self, navigator: Navigator, belief: Belief, tightness: int) -> Survey:
        survey = super()._survey(navigator, belief, tightness)
        self._explored_share = _free_share(survey.grid)
        return survey

    def _fail(self, survey: Survey, goal: Goal) -> None:
        super()._fail(survey, goal)
        self._blacklist.append(goal.frontier)
        del self._blacklist[: -self._params.max_blacklist_size]

    def _choose(self, survey: Survey) -> Goal | None:
        self._candidates = np.empty((0, 2))
        if survey.field is None:
            return None
        cells = np.argwhere(survey.frontier)
        if len(cells) == 0:
            return None
        for step in range(RELAXED + 1):
            params = self._params.relaxed(step)
            self._relaxation = step
            goal = self._best(survey, cells, params)
            if goal is not None:
                return goal
        return None

    def _best(self, survey: Survey, cells: np.ndarray, params: FrontierParams) -> Goal | None:
        """Return the reachable candidate of the greatest utility."""
        clusters = self._clusters(survey, cells, params)
        centroids = np.array([survey.grid.centers(cluster).mean(axis=0) for cluster in clusters]).reshape(-1, 2)
        keep = np.flatnonzero(_is_clear(survey, centroids, params))
        near = self._is_blacklisted(centroids, params.blacklist_radius)
        if 2 * np.count_nonzero(near[keep]) > len(keep):
            # More than half of what is left is blacklisted: forget the oldest two thirds of the list.
            del self._blacklist[: max(1, 2 * len(self._blacklist) // 3)]
            near = self._is_blacklisted(centroids, params.blacklist_radius)
        distances = np.hypot(*(centroids - survey.pose[:2]).T)
        keep = keep[~near[keep] & (distances[keep] >= params.min_goal_distance)]
        gains = np.array([_information_gain(survey, centroids[k], params) for k in keep])
        utilities = gains / (distances[keep] + 0.1)
        keep = keep[np.argsort(-utilities, kind="stable")]
        self._candidates = centroids[keep]
        for k in keep:
            goal = _reachable_goal(survey, centroids[k], clusters[k], params)
            if goal is not None:
                return goal
        return None

    def _clusters(self, survey: Survey, cells: np.ndarray, params: FrontierParams) -> list[np.ndarray]:
        """Group frontier cells with DBSCAN; what is too sparse is left out."""
        final = _free_share(survey.grid) > params.adaptive_threshold
        size = params.min_frontier_size_final if final else params.min_frontier_size
        labels, num_clusters = dbscan(survey.frontier, params.cluster_tolerance / survey.grid.resolution, size)
        by_label = cells[np.argsort(labels[cells[:, 0], cells[:, 1]], kind="stable")]
        firsts = np.searchsorted(np.sort(labels[cells[:, 0], cells[:, 1]]), np.arange(num_clusters))
        return np.split(by_label, firsts)[1:]

    def _is_blacklisted(self, points: np.ndarray, radius: float) -> np.ndarray:
        """Tell which points (shape (n, 2) [m]) lie within `radius` [m] of a goal that failed: shape (n,), bool."""
        if not self._blacklist or len(points) == 0:
            return np.zeros(len(points), dtype=bool)
        gaps = points[:, None] - np.array(self._blacklist)
        return (np.hypot(gaps[..., 0], gaps[..., 1]) < radius).any(axis=1)


def _free_share(grid: OccupancyGrid) -> float:
    """Return how many of a map's cells are known to be free."""
    return np.count_nonzero((grid.data >= 0) & (grid.data < FREE_BELOW)) / grid.data.size


def _is_clear(survey: Survey, points: np.ndarray, params: FrontierParams) -> np.ndarray:
    """Tell which points (shape (n, 2) [m]) keep the clearance to obstacles: shape (n,), bool."""
    reach = int(params.obstacle_clearance / survey.grid.resolution)
    if reach == 0 or len(points) == 0:
        return np.ones(len(points), dtype=bool)
    cells = survey.grid.cells(points)
    squared = squared_distances(survey.grid.data > params.obstacle_above, reach)
    return squared[cells[:, 0], cells[:, 1]] > reach**2


def _information_gain(survey: Survey, point: np.ndarray, params: FrontierParams) -> int:
    """Count the unknown cells around a point [m]."""
    grid = survey.grid
    radius = params.information_gain_radius
    if params.scale_radius_with_map:
        radius *= min(2.0, math.hypot(*grid.data.shape) * grid.resolution / 20.0)
    row, col = grid.cells(point)
    return int(count_unknown(grid.data, row, col, radius / grid.resolution))


def _reachable_goal(survey: Survey, centroid: np.ndarray, cluster: np.ndarray, params: FrontierParams) -> Goal | None:
    """Return where to stand for a cluster: near its centroid, or near its cell nearest to that; None if unreachable."""
    assert survey.field is not None
    grid = survey.grid
    middle = cluster[np.argmin(((grid.centers(cluster) - centroid) ** 2).sum(axis=1))]
    targets = np.vstack([grid.cells(centroid), middle])
    found = find_viewpoint(survey.field, targets, params.goal_tolerance)
    if found is None:
        return None
    cell, _ = found
    x, y = grid.centers(middle)
    return Goal(cell, (float(x), float(y)))
