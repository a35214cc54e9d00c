"""Frontier navigation to points: the candidates are the frontiers at the points of a detector, and no others."""

import numpy as np

from baselines.rrt.params import RrtParams
from envs.geometry import Pose2D
from envs.navigation import COST_MAX_FREE, COST_UNKNOWN, NO_POINTS, FrontierNavigator, PlanningParams
from envs.navigation.planning_map import CostLayer
from envs.robots import RobotParams


def _on_ros_scale(costs: np.ndarray) -> np.ndarray:
    """Return a costmap's costs on the scale on which ROS publishes costmaps, float64.

    1 to 98 near obstacles, 99 where the footprint touches one and beyond; 0 where it is free or unknown.
    """
    near = 1.0 + np.floor(97.0 * (costs - 1.0) / 251.0)
    return np.select([(costs == 0) | (costs == COST_UNKNOWN), costs > COST_MAX_FREE], [0.0, 99.0], near)


class PointNavigator(FrontierNavigator):
    """Offers, for each valid frontier point, the frontier cell nearest to it."""

    def __init__(self, robot: RobotParams, control_period: float, params: RrtParams) -> None:
        """Prepare for a robot that is updated every `control_period` seconds.

        Of `params` it reads `max_cost`, beyond which a point is invalid, `bandwidth`, up to which a frontier cell
        belongs to a point, and `view_distances`.
        """
        super().__init__(robot, control_period, planning=PlanningParams(view_distances=params.view_distances))
        self._params = params
        self.points = np.empty((0, 2))
        """Frontier points, shape (n, 2), float64, map frame [m]."""

    def _frontiers(self, layer: CostLayer) -> tuple[np.ndarray, np.ndarray]:
        """Return frontier cells, shape (k, 2), and one part for each, shape (k, 4); see `split_groups`."""
        planning, side = self.map, self.map.side
        positions = (self.points[:, ::-1] - planning.origin[::-1]) / side  # row, column
        cells = np.floor(positions).astype(np.int64)
        is_inside = ((cells >= 0) & (cells < planning.joined.shape)).all(axis=1)
        costs = np.full(len(cells), COST_UNKNOWN, dtype=np.uint8)
        costs[is_inside] = layer.costs[tuple(cells[is_inside].T)]
        is_valid = _on_ros_scale(costs) <= self._params.max_cost
        nearest = self._nearest_frontier(positions[is_valid])
        first = np.arange(len(nearest))
        # Of no group: no point is left out because its frontier is short.
        return nearest, np.column_stack([first, first + 1, np.full(len(nearest), planning.joined.size), first])

    def _nearest_frontier(self, positions: np.ndarray) -> np.ndarray:
        """Return the frontier cell (row, column) nearest to each point; nothing for points farther than the bandwidth.

        `positions`, shape (n, 2), are in cells: cell c holds [c, c + 1).
        """
        frontier, radius = self.map.frontier, self._params.bandwidth / self.map.side
        reach = int(np.ceil(radius))
        window = np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1))) - reach
        around = np.floor(positions).astype(np.int64)[:, None] + window
        gaps = np.hypot(*np.moveaxis(around + 0.5 - positions[:, None], -1, 0))
        inside = ((around >= 0) & (around < frontier.shape)).all(axis=-1)
        rows, cols = np.moveaxis(np.where(inside[..., None], around, 0), -1, 0)
        gaps[~(inside & frontier[rows, cols]) | (gaps > radius)] = np.inf
        nearest = np.arange(len(gaps)), gaps.argmin(axis=1)
        return around[nearest][np.isfinite(gaps[nearest])]

    def _replan(self, pose: Pose2D) -> bool:
        """Plan the path anew; through peers where none leads around them: they move on, or are made to yield."""
        if super()._replan(pose):
            return True
        bodies, self.bodies = self.bodies, NO_POINTS
        has_path = len(bodies) > 0 and super()._replan(pose)
        self.bodies = bodies
        return has_path
