"""Seed 2's detectors and filter: random trees find frontier points, few are kept of the many."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from baselines.rrt.filter import information_gain, mean_shift
from baselines.rrt.trees import Tree
from envs.geometry import OccupancyGrid
from envs.navigation import crop_to_known


@dataclass(frozen=True, slots=True)
class RrtParams:
    """Defaults: the launch file of seed 2 (that of the published program for one robot), unless marked as ours."""

    eta_local: float = 1.0
    """Greatest step of the local tree [m]; launch file."""
    eta_global: float = 15.0
    """Greatest step of the global tree [m]; launch file, one robot (1 m with three robots)."""
    bandwidth: float = 0.3
    """Bandwidth of the mean shift [m]; the program's filter."""
    info_radius: float = 1.0
    """Radius around a point in which unknown area is its gain [m]; launch file."""
    min_gain: float = 0.2
    """Unknown area within half of that radius below which a point is stale [m2]; the program's filter."""
    max_cost: float = 70.0
    """Cost above which a point is invalid, on ROS's scale: 99 touches an obstacle [percent]; launch file."""
    info_multiplier: float = 3.0
    """Lambda: how much way a gain is worth [1/m]; launch file."""
    hysteresis_radius: float = 3.0
    """Distance from the robot up to which gains are multiplied [m]; launch file."""
    hysteresis_gain: float = 2.0
    """By what they are multiplied; launch file."""
    num_samples: int = 200
    """Samples per tree and control step; ours (the program takes 10 in 0.1 s, and one for each loop of its own)."""
    spacing: float = 0.3
    """Least distance of a new vertex from the nearest one [m]; ours."""
    margin: float = 1.0
    """How far beyond everything observed samples are drawn [m]; ours."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """How far from a frontier the robot may stand to see it; the first from which it can is taken [m]; ours."""
    patience: int = 100
    """Control steps without a point that could be assigned after which exploration ends; ours."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "view_distances" and not value > 0:
                raise ValueError(f"{field.name} must be positive, got {value}")
        if not self.hysteresis_gain > 1:
            raise ValueError(f"hysteresis_gain must be greater than 1, got {self.hysteresis_gain}")
        if not self.view_distances or min(self.view_distances) < 0:
            raise ValueError(f"view_distances must hold distances of at least 0, got {self.view_distances}")
        if not min(self.eta_local, self.eta_global) >= self.spacing:
            raise ValueError(f"spacing must be at most eta_local and eta_global, got {self.spacing}")


class RrtDetector:
    """One local tree per robot, one global tree, and the filter that takes in what they find."""

    def __init__(self, params: RrtParams, rng: np.random.Generator) -> None:
        """Prepare for an episode; samples are drawn from `rng`."""
        self._params = params
        self._rng = rng
        self.trees: list[Tree] = []
        """The local trees, then the global one; none before anything was detected."""
        self.points = np.empty((0, 2))
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""

    def detect(self, grid: OccupancyGrid, robots: Sequence[tuple[float, float]]) -> None:
        """Let the trees grow for a control step, and filter the points.

        Args:
            grid: the map.
            robots: where the robots are (x, y), map frame [m]; the global tree starts at the first one.
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
