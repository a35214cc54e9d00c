import numpy as np

from lidarnaut.baselines.rrt.detector import RrtParams
from lidarnaut.envs.navigation import COST_MAX_FREE, COST_UNKNOWN, NO_POINTS
from lidarnaut.envs.navigation.maps.planning_map import CostLayer
from lidarnaut.envs.navigation.teams.team_robot import TeamRobot
from lidarnaut.envs.robots import RobotParams


class RrtRobot(TeamRobot):
    """Robot of a team that drives to frontiers found by random trees (RRT)."""

    def __init__(self, robot: RobotParams, control_period: float, params: RrtParams, index: int) -> None:
        super().__init__(robot, control_period, index, patience=params.patience)
        self.points = NO_POINTS
        self._params = params

    def _frontiers(self, layer: CostLayer) -> tuple[np.ndarray, np.ndarray]:
        planning, side = self.map, self.map.side
        positions = (self.points[:, ::-1] - planning.origin[::-1]) / side  # row, column
        cells = np.floor(positions).astype(np.int64)
        is_inside = ((cells >= 0) & (cells < planning.occupancy.shape)).all(axis=1)
        costs = np.full(len(cells), COST_UNKNOWN, dtype=np.uint8)
        costs[is_inside] = layer.costs[tuple(cells[is_inside].T)]
        # ROS costmap scale: 1 to 98 near obstacles, 99 for contact of the footprint.
        near = 1.0 + np.floor(97.0 * (costs - 1.0) / 251.0)
        on_ros_scale = np.select([(costs == 0) | (costs == COST_UNKNOWN), costs > COST_MAX_FREE], [0.0, 99.0], near)
        nearest = self._nearest_frontier(positions[on_ros_scale <= self._params.max_cost])
        first = np.arange(len(nearest))
        # Without a group, points of short frontiers are kept.
        return nearest, np.column_stack([first, first + 1, np.full(len(nearest), planning.occupancy.size), first])

    def _nearest_frontier(self, positions: np.ndarray) -> np.ndarray:
        frontier, radius = self.map.frontier, self._params.bandwidth / self.map.side
        reach = int(np.ceil(radius))
        window = np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1))) - reach
        neighbors = np.floor(positions).astype(np.int64)[:, None] + window
        gaps = np.hypot(*np.moveaxis(neighbors + 0.5 - positions[:, None], -1, 0))
        inside = ((neighbors >= 0) & (neighbors < frontier.shape)).all(axis=-1)
        rows, cols = np.moveaxis(np.where(inside[..., None], neighbors, 0), -1, 0)
        gaps[~(inside & frontier[rows, cols]) | (gaps > radius)] = np.inf
        nearest = np.arange(len(gaps)), gaps.argmin(axis=1)
        return neighbors[nearest][np.isfinite(gaps[nearest])]
