"""The frontier explorer of the warehouse AGV report, 2024: DBSCAN, clearance, utility, blacklist, progress.

The report: "Hệ thống AGV tự động khám phá map cho smart warehouse".

Where the report leaves something open, the program that it describes decides: DBSCAN's `min_samples` is the least
frontier size, the radius of the information gain is scaled by the map's diagonal over 20 m (at most doubled), and a
blacklist that covers too much forgets its oldest two thirds. Candidates are what a path leads to, which the report asks
Nav2 for one by one. A robot that is stuck gives its goal up: that cancels the path, blacklists the goal, and the next
one is chosen at once. Two things had to be settled anew:

- *Share explored.* The report divides the free cells by all cells of the map, and its map ends where observations end.
  Ours grows ahead of them, so the rectangle around everything observed replaces the map.
- *Starvation.* The report's distances suit a warehouse; in a small world nothing passes its filters. When no candidate
  is left, the filters are relaxed step by step (`FrontierParams.relaxed`), and the last step takes whatever there is.
"""

import logging
import math
from dataclasses import replace
from itertools import accumulate
from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.frontier.explorer import COMMITTED, RuleExplorer
from lidarnaut.baselines.frontier.rules import CELL
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.navigation import Candidates, crop_to_known
from lidarnaut.envs.navigation.costmap import OCCUPIED_FROM
from lidarnaut.envs.navigation.frontiers import information_gain
from lidarnaut.envs.robots import RobotParams

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrontierParams:
    """Defaults: `exploration_params.yaml` of the report, section 3.3.1."""

    cluster_tolerance: PositiveFloat = 0.5
    """Distance up to which DBSCAN counts frontier cells as neighbours [m]."""
    min_frontier_size: int = 8
    """Frontier cells of 5 cm that make a cluster dense."""
    min_frontier_size_final: PositiveInt = 3
    """The same once `adaptive_threshold` is passed."""
    adaptive_threshold: Annotated[float, Field(ge=0.0, le=1.0)] = 0.7
    """Share explored from which small frontiers count too."""
    obstacle_clearance: NonNegativeFloat = 0.5
    """Least distance of a cluster's centroid from obstacles [m]."""
    obstacle_above: Annotated[int, Field(ge=0, lt=100)] = 50
    """Occupancy above which a cell is an obstacle for the clearance [percent]."""
    information_gain_radius: PositiveFloat = 2.0
    """Radius around a centroid in which unknown cells are counted [m]."""
    scale_radius_with_map: bool = True
    """Whether that radius is multiplied by the map's diagonal over 20 m, at most by 2."""
    min_goal_distance: NonNegativeFloat = 1.2
    """Least distance of a goal from the robot [m]."""
    goal_tolerance: NonNegativeFloat = 0.3
    """Farthest viewpoint from a centroid (planner's tolerance, section 3.3.2) [m]."""
    blacklist_radius: NonNegativeFloat = 1.2
    """Goals this near to one that failed are left out [m]."""
    max_blacklist_size: PositiveInt = 25
    """Failed goals that are remembered."""

    def __post_init__(self) -> None:
        if not self.min_frontier_size_final <= self.min_frontier_size:
            sizes = f"{self.min_frontier_size_final} for {self.min_frontier_size}"
            raise ValueError(f"min_frontier_size_final must lie in [1, min_frontier_size], got {sizes}")

    def gain_radius(self, grid: OccupancyGrid) -> float:
        """Return the radius in which unknown cells of a map are counted [m]."""
        diagonal = math.hypot(*grid.data.shape) * grid.resolution
        return self.information_gain_radius * (min(2.0, diagonal / 20.0) if self.scale_radius_with_map else 1.0)

    def relaxed(self) -> list["FrontierParams"]:
        """Return these params and those after each relaxation step.

        The steps: clusters of the final size; no clearance beyond the robot's footprint; goals near the robot;
        frontiers seen from up to a metre away; goals that failed before.
        """
        steps: tuple[dict[str, Any], ...] = (
            {"min_frontier_size": self.min_frontier_size_final},
            {"obstacle_clearance": 0.0},
            {"min_goal_distance": 0.0},
            {"goal_tolerance": 1.0},
            {"blacklist_radius": 0.0},
        )
        return list(accumulate(steps, lambda params, step: replace(params, **step), initial=self))


class FrontierUtility:
    """Takes the cluster of frontier cells with the greatest information gain over the distance."""

    def __init__(self, params: FrontierParams) -> None:
        self._params, self._steps = params, params.relaxed()
        self._clear()

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._clear()

    def _clear(self) -> None:
        self.goal: tuple[float, float] | None = None
        """The frontier that the robot is going to see (x, y), map frame [m]."""
        self.relaxation = 0
        """Relaxation step of the last choice, from 0 for none to 5."""
        self.blacklist: list[tuple[float, float]] = []
        """Failed goals that are remembered."""

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        if candidates.last_failed and self.goal is not None:
            self.blacklist.append(self.goal)
            del self.blacklist[: -self._params.max_blacklist_size]
        grid = crop_to_known(candidates.costmap.grid)
        share = np.count_nonzero((grid.data >= 0) & (grid.data < OCCUPIED_FROM)) / grid.data.size
        for step, params in enumerate(self._steps):
            self.relaxation = step
            choice, num_clusters = self._best(candidates, grid, belief, params, share)
            if choice is not None:
                break
        choice = choice or 0
        x, y = candidates["frontier"][choice].tolist()
        self.goal = x, y
        LOGGER.info(
            "%.0f %% explored, goal (%.2f, %.2f), %d candidates at relaxation %d, %d blacklisted",
            *(100.0 * share, x, y, num_clusters, self.relaxation, len(self.blacklist)),
        )
        scores = np.full(len(candidates), -np.inf)
        scores[choice] = 0.0
        return scores

    def _best(
        self, candidates: Candidates, grid: OccupancyGrid, belief: Belief, params: FrontierParams, share: float
    ) -> tuple[int | None, int]:
        """Return the candidate of the cluster with the greatest utility, and from how many clusters it was chosen."""
        size = params.min_frontier_size_final if share > params.adaptive_threshold else params.min_frontier_size
        cells, owners, labels = cluster(candidates, params.cluster_tolerance, size)
        num_clusters = int(labels.max(initial=-1)) + 1
        centroids = np.array([cells[labels == k].mean(axis=0) for k in range(num_clusters)]).reshape(-1, 2)
        keep = np.flatnonzero(is_clear(grid, centroids, params))
        near = self._is_blacklisted(centroids, params.blacklist_radius)
        if 2 * np.count_nonzero(near[keep]) > len(keep):
            # More than half of what is left is blacklisted: forget the oldest two thirds of the list.
            del self.blacklist[: max(1, 2 * len(self.blacklist) // 3)]
            near = self._is_blacklisted(centroids, params.blacklist_radius)
        distances = np.hypot(*(centroids - belief.pose[:2]).T)
        keep = keep[~near[keep] & (distances[keep] >= params.min_goal_distance)]
        gains = information_gain(grid, centroids[keep], params.gain_radius(grid))
        keep = keep[np.argsort(-gains / (distances[keep] + 0.1), kind="stable")]
        gaps = np.hypot(*(candidates["viewpoint"] - candidates["frontier"]).T)
        is_near_enough = gaps <= params.goal_tolerance + candidates.costmap.grid.resolution
        for k in keep:
            own = np.flatnonzero((labels == k) & is_near_enough[owners])
            if len(own):
                middle = own[np.argmin(((cells[own] - centroids[k]) ** 2).sum(axis=1))]
                return int(owners[middle]), len(keep)
        return None, len(keep)

    def _is_blacklisted(self, points: np.ndarray, radius: float) -> np.ndarray:
        """Tell which points (shape (n, 2) [m]) lie within `radius` [m] of a goal that failed: shape (n,), bool."""
        gaps = points[:, None] - np.array(self.blacklist).reshape(-1, 2)
        return (np.hypot(gaps[..., 0], gaps[..., 1]) < radius).any(axis=1)


class FrontierExplorer(RuleExplorer):
    """Goes where `FrontierUtility` says."""

    rule: FrontierUtility

    def __init__(self, params: FrontierParams = FrontierParams()) -> None:
        super().__init__(FrontierUtility(params), max_time=COMMITTED)


def cluster(candidates: Candidates, tolerance: float, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group the candidates' cells with DBSCAN (Ester, Kriegel, Sander, Xu, 1996).

    `tolerance`: distance up to which cells are neighbours [m]; `size`: cells of 5 cm that make a cluster dense. Returns
    cells, shape (n, 2), float64 [m]; the candidate that each belongs to, shape (n,), int64; and its cluster, shape
    (n,), int64, -1 for what is too sparse.
    """
    from sklearn.cluster import DBSCAN  # takes longest to load, and other explorers need none of it

    parts = candidates.cells
    cells = np.concatenate(parts)
    owners = np.repeat(np.arange(len(candidates)), [len(own) for own in parts])
    # A frontier crosses half as many cells that are twice as large.
    min_samples = max(1, round(size * CELL / candidates.costmap.grid.resolution))
    return cells, owners, DBSCAN(eps=tolerance + 1e-9, min_samples=min_samples).fit(cells).labels_


def is_clear(grid: OccupancyGrid, points: np.ndarray, params: FrontierParams) -> np.ndarray:
    """Tell which points (shape (n, 2) [m], inside the map) keep the clearance to obstacles: shape (n,), bool."""
    reach = int(params.obstacle_clearance / grid.resolution + 1e-9)
    if reach == 0 or len(points) == 0:
        return np.ones(len(points), dtype=np.bool_)
    squared = squared_distances(grid.data > params.obstacle_above, reach)
    return squared[tuple(grid.cells(points).T)] > reach**2
