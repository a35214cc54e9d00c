"""Frontier explorer of the report "Hệ thống AGV tự động khám phá map cho smart warehouse", 2024.

Clusters of frontier cells near obstacles, the robot or failed goals are discarded. The rest is ranked by information
gain divided by distance. Unlike in the report, filters are relaxed if no cluster passes.
"""

import logging
import math
from dataclasses import replace
from itertools import accumulate
from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.frontier.rule_explorer import COMMITTED, RuleExplorer
from lidarnaut.baselines.frontier.rules import CELL
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.navigation import Candidates, DwbPlanner, FrontierNavigator, crop_to_known
from lidarnaut.envs.navigation.frontiers.frontiers import information_gain
from lidarnaut.envs.navigation.maps.planning_params import DwbParams, NavigatorParams, PlanningParams
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrontierParams:
    """Parameters of frontier clusters, filters and scores. Defaults: report cited in this module, section 3.3.1."""

    cluster_tolerance: PositiveFloat = 0.5
    """Maximum distance between neighboring frontier cells in a cluster [m] (`eps` of DBSCAN)."""
    min_frontier_size: int = 8
    """Minimum number of 5 cm frontier cells near a core cell of a cluster (`min_samples` of DBSCAN)."""
    min_frontier_size_final: PositiveInt = 3
    """Value that replaces `min_frontier_size` late in exploration, above `adaptive_threshold`."""
    adaptive_threshold: Annotated[float, Field(ge=0.0, le=1.0)] = 0.7
    """Fraction of free cells in the known map's bounding box above which `min_frontier_size_final` applies."""
    obstacle_clearance: NonNegativeFloat = 0.5
    """Minimum distance between the centroid of a frontier cluster and obstacles [m]."""
    obstacle_above: Annotated[int, Field(ge=0, lt=100)] = 50
    """Occupancy above which a cell is an obstacle for `obstacle_clearance` [percent]."""
    information_gain_radius: PositiveFloat = 2.0
    """Radius around the centroid of a frontier cluster for counting unknown area [m]."""
    scale_radius_with_map: bool = True
    """Whether `information_gain_radius` grows with the map, by the factor min(2, map diagonal / 20 m)."""
    min_goal_distance: NonNegativeFloat = 1.2
    """Minimum distance of a goal from the robot [m]."""
    goal_tolerance: NonNegativeFloat = 0.3
    """Maximum distance of a frontier from its viewpoint, the goal of the drive [m]."""
    blacklist_radius: NonNegativeFloat = 1.2
    """Radius around failed goals within which frontiers are excluded [m]."""
    max_blacklist_size: PositiveInt = 25
    """Maximum number of failed goals to remember."""

    def __post_init__(self) -> None:
        if not self.min_frontier_size_final <= self.min_frontier_size:
            sizes = f"{self.min_frontier_size_final} for {self.min_frontier_size}"
            raise ValueError(f"min_frontier_size_final must lie in [1, min_frontier_size], got {sizes}")

    def gain_radius(self, grid: OccupancyGrid) -> float:
        diagonal = math.hypot(*grid.data.shape) * grid.resolution
        return self.information_gain_radius * (min(2.0, diagonal / 20.0) if self.scale_radius_with_map else 1.0)

    def relaxed(self) -> list["FrontierParams"]:
        """Return parameters to try in turn until a frontier passes; each set relaxes one more filter than the last."""
        steps: Any = {"min_frontier_size": self.min_frontier_size_final, "obstacle_clearance": 0.0}
        steps |= {"min_goal_distance": 0.0, "goal_tolerance": 1.0, "blacklist_radius": 0.0}
        return list(accumulate(steps.items(), lambda params, step: replace(params, **dict([step])), initial=self))


class FrontierUtility:
    """Selects the frontier cluster with the highest information gain divided by distance."""

    def __init__(self, params: FrontierParams) -> None:
        self._params, self._steps = params, params.relaxed()

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self.goal: tuple[float, float] | None = None
        self.relaxation = 0
        self.blacklist: list[tuple[float, float]] = []

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        if candidates.last_failed and self.goal is not None:
            self.blacklist.append(self.goal)
            del self.blacklist[: -self._params.max_blacklist_size]
        grid = crop_to_known(candidates.costmap.grid)
        share = np.count_nonzero(grid.free) / grid.data.size
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
        size = params.min_frontier_size_final if share > params.adaptive_threshold else params.min_frontier_size
        cells, owners, labels = cluster(candidates, params.cluster_tolerance, size)
        num_clusters = int(labels.max(initial=-1)) + 1
        centroids = np.array([cells[labels == k].mean(axis=0) for k in range(num_clusters)]).reshape(-1, 2)
        keep = np.flatnonzero(is_clear(grid, centroids, params))
        near = self._is_blacklisted(centroids, params.blacklist_radius)
        if 2 * np.count_nonzero(near[keep]) > len(keep):
            # Most clusters are blacklisted: forget the oldest two thirds.
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
        gaps = points[:, None] - np.array(self.blacklist).reshape(-1, 2)
        return (np.hypot(gaps[..., 0], gaps[..., 1]) < radius).any(axis=1)


AGV_DWB = DwbParams(
    max_vel_x=0.78,
    max_vel_theta=2.0,
    acc_lim_x=4.0,
    acc_lim_theta=5.0,
    sim_time=2.5,
    base_obstacle_scale=0.05,
    path_align_scale=35.0,
    path_dist_scale=35.0,
    goal_align_scale=26.0,
    goal_dist_scale=26.0,
    forward_point_distance=0.2,
    xy_goal_tolerance=0.3,
    width=10.0,
    inflation_radius=0.6,
    cost_scaling_factor=2.5,
)
"""DWB parameters of the report, section 3.3.2; scales and angular acceleration from its program."""
AGV_PLANNING = PlanningParams(inflation=0.231, cost_scaling_factor=2.5)
"""Costmap of the report, section 3.3.2: `inflation_radius` 0.6 m, less the radius of Tugbot."""
AGV_LIMITS = NavigatorParams(stuck_time=30.0, max_goal_tolerance=0.3)
"""Stuck detection and goal tolerance of the report, sections 3.4.3 and 3.3.2."""


class FrontierExplorer(RuleExplorer):
    """Drives to the frontier cluster with the highest information gain divided by distance."""

    rule: FrontierUtility

    def __init__(self, params: FrontierParams = FrontierParams(), dwb: DwbParams | None = None) -> None:
        """Create an explorer that drives by pure pursuit, or with `dwb` by DWB and the report's values of all parts."""
        nav2: Any = {} if dwb is None else {"planning": AGV_PLANNING, "params": AGV_LIMITS}
        super().__init__(FrontierUtility(params), max_time=COMMITTED, **nav2)
        self.dwb = dwb

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._planner = DwbPlanner(robot, control_period, self.dwb) if self.dwb else None

    def _count_failed(self, navigator: FrontierNavigator) -> int:
        return len(self.rule.blacklist)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        twist, planner = super().act(reading, belief), self._planner
        drive: Any = self.navigator and self.navigator.navigator
        if planner is None or self.end_reason or drive.is_recovering or drive.plan is None:
            return twist
        if math.dist(drive.goal, belief.pose[:2]) > drive.numbers["goal_tolerance"]:
            planner.set_path(drive.plan)
            twist = planner.command(belief.pose, drive.velocity, drive.obstacles)
            drive.note_command(twist)
        return twist


def cluster(candidates: Candidates, tolerance: float, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cluster frontier cells by DBSCAN (Ester, Kriegel, Sander, Xu, 1996).

    `candidates`: reachable frontiers. `tolerance`: `eps` of DBSCAN [m]. `size`: `min_samples` of DBSCAN for 5 cm cells.

    Returns:
        Centers of frontier cells, shape (n, 2), float64, map frame [m]; frontier index and cluster index (-1 for noise)
        of each cell, shape (n,), int64.
    """
    from sklearn.cluster import DBSCAN  # slow import

    parts = candidates.cells
    cells = np.concatenate(parts)
    owners = np.repeat(np.arange(len(candidates)), [len(own) for own in parts])
    # A frontier crosses half as many cells of twice the side.
    min_samples = max(1, round(size * CELL / candidates.costmap.grid.resolution))
    return cells, owners, DBSCAN(eps=tolerance + 1e-9, min_samples=min_samples).fit(cells).labels_


def is_clear(grid: OccupancyGrid, points: np.ndarray, params: FrontierParams) -> np.ndarray:
    """Return whether points keep `params.obstacle_clearance` from obstacles, shape (n,), bool.

    `points`: shape (n, 2), inside the map, map frame [m].
    """
    reach = int(params.obstacle_clearance / grid.resolution + 1e-9)
    if reach == 0 or len(points) == 0:
        return np.ones(len(points), dtype=np.bool_)
    squared = squared_distances(grid.data > params.obstacle_above, reach)
    return squared[tuple(grid.cells(points).T)] > reach**2
