"""Frontier detection by random trees and a mean-shift filter (Nguyen et al. 2022, section 2.1.2).

The mean shift is about 200 times faster than scikit-learn's `MeanShift`.
"""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.rrt.trees import SPACING, Tree
from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.navigation.frontiers.frontiers import information_gain

MAX_ITERATIONS = 300
TOLERANCE = 1e-3
"""Mean-shift step at convergence, as a fraction of the bandwidth."""
NUM_SAMPLES, MARGIN = 200, 1.0
"""Random samples per tree and control step, and margin of the sampling region around the observed area [m]."""
StepLength = Annotated[float, Field(ge=SPACING)]


@dataclass(frozen=True, slots=True)
class RrtParams:
    """Parameters of exploration by random trees.

    Defaults are from the launch file of Nguyen et al. (2022), except for `bandwidth` and `min_gain` (their program),
    and `patience`.
    """

    eta_local: StepLength = 1.0
    """Maximum step length of the local tree, which restarts at the robot [m]."""
    eta_global: StepLength = 15.0
    """Maximum step length of the global tree, which never restarts [m]."""
    bandwidth: PositiveFloat = 0.3
    """Kernel radius of the mean shift that merges frontier points [m]."""
    info_radius: PositiveFloat = 1.0
    """Radius of the information gain (unknown area) around a frontier point [m]."""
    min_gain: PositiveFloat = 0.2
    """Minimum unknown area around a frontier point, within half of `info_radius` [m2]; other points are discarded."""
    max_cost: PositiveFloat = 70.0
    """Maximum costmap cost at a frontier point, on ROS's scale from 0 (free) to 99 (contact with an obstacle)."""
    info_multiplier: PositiveFloat = 3.0
    """Weight of information gain (unknown area) relative to path length, lambda [1/m]."""
    hysteresis_radius: PositiveFloat = 3.0
    """Radius around the robot within which information gain is multiplied by `hysteresis_gain` [m]."""
    hysteresis_gain: Annotated[float, Field(gt=1.0)] = 2.0
    """Factor on information gain within `hysteresis_radius` of the robot."""
    patience: PositiveInt = 100
    """Number of control steps without an assignable frontier point after which exploration ends."""
    view_radius: NonNegativeFloat = 0.0
    """Radius of the unknown area in view of a frontier point [m], whose quotient by the path cost is then the revenue
    (score) of the point; 0: the revenue of Nguyen et al. (2022)."""
    turn_cost: NonNegativeFloat = 0.0
    """Path length that counts as much as a turn of 1 rad at the start of the path [m/rad]."""
    period: PositiveFloat = math.inf
    """Time after which driving robots get a new frontier point [s]; 0.5 in the program of Umari and Mukhopadhyay."""
    pursuit: bool = False
    """Whether robots do not slow down in bends, as those of the explorer `pursuit`."""


TEAM_PARAMS = RrtParams(eta_global=1.0)
"""Parameters of exploration by random trees with several robots, from the launch file of Nguyen et al. (2022)."""


@njit(cache=True, error_model="numpy")
def _converge(points, bandwidth):
    means, counts = points.copy(), np.zeros(len(points), dtype=np.int64)
    xs = points[:, 0].copy()
    # Neighbors are in this strip, widened against rounding.
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
                break  # rounding: all points are exactly on the circle
            moved = np.hypot(sum_x / count - x, sum_y / count - y)
            x, y, counts[k] = sum_x / count, sum_y / count, count
            if moved <= TOLERANCE * bandwidth:
                break
        means[k] = x, y
    return means, counts


@njit(cache=True, error_model="numpy")
def _suppress_near(means, bandwidth):
    kept = np.ones(len(means), dtype=np.bool_)
    for k in range(len(means)):
        for j in range(k + 1, len(means) if kept[k] else 0):
            kept[j] &= (means[j, 0] - means[k, 0]) ** 2 + (means[j, 1] - means[k, 1]) ** 2 > bandwidth * bandwidth
    return kept


def mean_shift(points: np.ndarray, bandwidth: float) -> np.ndarray:
    """Cluster points by mean shift with a flat kernel (Comaniciu and Meer 2002).

    `points`: shape (n, 2), float64 [m]. `bandwidth`: kernel radius, and minimum distance between cluster centers [m].
    Returns cluster centers, densest first, shape (k, 2), float64 [m].
    """
    means, counts = _converge(points[np.argsort(points[:, 0], kind="stable")], bandwidth)
    means = means[np.lexsort((means[:, 1], means[:, 0], counts))[::-1]]
    return means[_suppress_near(means, bandwidth)]


class RrtDetector:
    """Frontier detector with a local random tree per robot and a global tree."""

    def __init__(self, params: RrtParams, rng: np.random.Generator) -> None:
        self._params, self._rng = params, rng
        self.trees: list[Tree] = []
        """Local tree of each robot, then the global tree."""
        self.points = np.empty((0, 2))
        """Frontier points merged by mean shift, shape (n, 2), float64, map frame [m]."""
        self.found = np.empty((0, 2))
        """Frontier points found in the last control step, shape (n, 2), float64, map frame [m]."""

    def detect(self, grid: OccupancyGrid, robots: Sequence[tuple[float, float]]) -> None:
        """Grow the trees for one control step, and update the frontier points.

        `robots`: positions (x, y), map frame [m].
        """
        params = self._params
        if not self.trees:
            self.trees = [Tree(robot, eta=params.eta_local, resets=True) for robot in robots]
            self.trees.append(Tree(robots[0], eta=params.eta_global, resets=False))
        x0, y0, x1, y1 = crop_to_known(grid).bounds
        low, high = np.array([x0, y0]) - MARGIN, np.array([x1, y1]) + MARGIN
        found = [
            tree.grow(grid, self._rng.uniform(low, high, (NUM_SAMPLES, 2)), robot)
            for tree, robot in zip(self.trees, (*robots, robots[0]), strict=True)
        ]
        self.found = np.concatenate(found)
        points = mean_shift(np.concatenate([self.points, self.found]), params.bandwidth)
        gains = information_gain(grid, points, 0.5 * params.info_radius)
        self.points = points[gains >= params.min_gain]
