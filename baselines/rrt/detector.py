"""Frontier detection (Nguyen et al. 2022, section 2.1.2): random trees find frontier points, a filter keeps a few.

The mean shift is not scikit-learn's `MeanShift`, which the tests compare it with: that one searches neighbours for one
seed at a time, and takes 50 to 270 ms for the 100 to 430 points of a control step of 100 ms, 70 to 140 ms with
`bin_seeding=True`. Distances between all points in NumPy and SciPy take up to 10 ms, these kernels up to 0.3 ms.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from pydantic import PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.rrt.trees import Tree
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.navigation.frontiers import information_gain

MAX_ITERATIONS = 300
"""Steps after which a mean counts as converged, as in scikit-learn."""
TOLERANCE = 1e-3
"""Share of the bandwidth that a converged mean moves less than in a step, as in scikit-learn."""


@dataclass(frozen=True, slots=True)
class RrtParams:
    """Defaults: the launch file of Nguyen et al. (2022), that of the published program for one robot, or ours."""

    eta_local: PositiveFloat = 1.0
    """Longest step of the local tree [m]; launch file."""
    eta_global: PositiveFloat = 15.0
    """Longest step of the global tree [m]; launch file, one robot (1 m with three robots)."""
    bandwidth: PositiveFloat = 0.3
    """Bandwidth of the mean shift [m]; the program's filter."""
    info_radius: PositiveFloat = 1.0
    """Radius around a point in which unknown area is its information gain [m]; launch file."""
    min_gain: PositiveFloat = 0.2
    """Unknown area within half of that radius below which a point is stale [m2]; the program's filter."""
    max_cost: PositiveFloat = 70.0
    """Cost above which a point is invalid, on ROS's scale: 99 touches an obstacle [percent]; launch file."""
    info_multiplier: PositiveFloat = 3.0
    """Lambda: length of path that a unit of gain is worth [1/m]; launch file."""
    hysteresis_radius: PositiveFloat = 3.0
    """Distance from the robot up to which gains are multiplied [m]; launch file."""
    hysteresis_gain: PositiveFloat = 2.0
    """Factor of that multiplication; launch file."""
    num_samples: PositiveInt = 200
    """Samples per tree and control step; ours (the program takes 10 in 0.1 s, and one for each loop of its own)."""
    spacing: PositiveFloat = 0.3
    """Least distance of a new vertex from the nearest one [m]; ours."""
    margin: PositiveFloat = 1.0
    """How far beyond everything observed samples are drawn [m]; ours."""
    patience: PositiveInt = 100
    """Control steps without a point that could be assigned after which exploration ends; ours."""

    def __post_init__(self) -> None:
        if not self.hysteresis_gain > 1:
            raise ValueError(f"hysteresis_gain must be greater than 1, got {self.hysteresis_gain}")
        if not min(self.eta_local, self.eta_global) >= self.spacing:
            raise ValueError(f"spacing must be at most eta_local and eta_global, got {self.spacing}")


TEAM_PARAMS = RrtParams(eta_global=1.0)
"""The launch file of the published program for three robots."""


@njit(cache=True, error_model="numpy")
def _converge(points, bandwidth):
    """Move from each point (shape (n, 2), float64, in the order of x) to the mean of those around it, until that stays.

    Returns the means, shape (n, 2), float64, and the number of points around each, shape (n,), int64.
    """
    means, counts = points.copy(), np.zeros(len(points), dtype=np.int64)
    xs = points[:, 0].copy()
    # Only points in this strip can lie around; slightly wider, so that rounding leaves none out.
    strip = bandwidth * (1.0 + 1e-9)
    for k in range(len(points)):
        x, y = points[k]
        for _ in range(MAX_ITERATIONS):
            sum_x, sum_y, count = 0.0, 0.0, 0
            for j in range(np.searchsorted(xs, x - strip), np.searchsorted(xs, x + strip)):
                inside = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 <= bandwidth * bandwidth
                sum_x += points[j, 0] if inside else 0.0
                sum_y += points[j, 1] if inside else 0.0
                count += inside
            if count == 0:
                break  # rounding: all points lay exactly as far away as the bandwidth
            moved = np.hypot(sum_x / count - x, sum_y / count - y)
            x, y, counts[k] = sum_x / count, sum_y / count, count
            if moved <= TOLERANCE * bandwidth:
                break
        means[k] = x, y
    return means, counts


@njit(cache=True, error_model="numpy")
def _suppress_near(means, bandwidth):
    """Return which means (shape (n, 2)) lie beyond the bandwidth of all before them that do: shape (n,), bool."""
    kept = np.ones(len(means), dtype=np.bool_)
    for k in range(len(means)):
        for j in range(k + 1, len(means) if kept[k] else 0):
            kept[j] &= (means[j, 0] - means[k, 0]) ** 2 + (means[j, 1] - means[k, 1]) ** 2 > bandwidth * bandwidth
    return kept


def mean_shift(points: np.ndarray, bandwidth: float) -> np.ndarray:
    """Cluster points, shape (n, 2), float64 [m], by mean shift with a flat kernel (Comaniciu and Meer 2002).

    `bandwidth`: its radius, and least distance between two centres [m]. Returns the centres, shape (k, 2), float64 [m],
    those with most points around them first.
    """
    means, counts = _converge(points[np.argsort(points[:, 0], kind="stable")], bandwidth)
    means = means[np.lexsort((means[:, 1], means[:, 0], counts))[::-1]]
    return means[_suppress_near(means, bandwidth)]


class RrtDetector:
    """One local tree per robot, one global tree, and the filter that takes their points."""

    def __init__(self, params: RrtParams, rng: np.random.Generator) -> None:
        self._params, self._rng = params, rng
        self.trees: list[Tree] = []
        """The local trees, then the global one; none before the first detection."""
        self.points = np.empty((0, 2))
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""

    def detect(self, grid: OccupancyGrid, robots: Sequence[tuple[float, float]]) -> None:
        """Grow the trees for a control step of the robots at (x, y), map frame [m], and filter the points.

        The global tree starts at the first robot.
        """
        params = self._params
        if not self.trees:
            self.trees = [Tree(robot, eta=params.eta_local, spacing=params.spacing, resets=True) for robot in robots]
            self.trees.append(Tree(robots[0], eta=params.eta_global, spacing=params.spacing, resets=False))
        x0, y0, x1, y1 = crop_to_known(grid).bounds
        low, high = np.array([x0, y0]) - params.margin, np.array([x1, y1]) + params.margin
        found = [
            tree.grow(grid, self._rng.uniform(low, high, (params.num_samples, 2)), robot)
            for tree, robot in zip(self.trees, (*robots, robots[0]), strict=True)
        ]
        points = mean_shift(np.concatenate([self.points, *found]), params.bandwidth)
        gains = information_gain(grid, points, 0.5 * params.info_radius)
        self.points = points[gains >= params.min_gain]
