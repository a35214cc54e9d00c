"""Frontier detection: random trees find frontier points, the filter keeps few of them."""

from collections.abc import Sequence

import numpy as np

from baselines.rrt.filter import information_gain, mean_shift
from baselines.rrt.params import RrtParams
from baselines.rrt.trees import Tree
from envs.geometry import OccupancyGrid
from envs.navigation import crop_to_known


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
