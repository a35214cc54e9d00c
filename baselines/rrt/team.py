"""Explorers that assign the frontier points of random trees to robots.

Nguyen, Tran and Nguyen, "SLAM cho robot di động" (2022), after Umari and Mukhopadhyay, "Autonomous Robotic Exploration
Based on Multiple Rapidly-exploring Randomized Trees" (2017). Unlike in the program of 2022, samples come from the
observed area, navigation costs are path lengths, and exploration ends after `patience` steps without an assignable
point.
"""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.baselines.rrt.detector import TEAM_PARAMS, RrtDetector, RrtParams
from lidarnaut.baselines.teams.team import TeamExplorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import COST_MAX_FREE, COST_UNKNOWN, NO_POINTS, Markers
from lidarnaut.envs.navigation.frontiers.frontiers import information_gain
from lidarnaut.envs.navigation.frontiers.views import visible_gain
from lidarnaut.envs.navigation.maps.planning_map import CostLayer
from lidarnaut.envs.navigation.teams.team_navigator import UNASSIGNED
from lidarnaut.envs.navigation.teams.team_robot import TeamRobot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

LEAST_COST = 0.3
"""Constant added to the path cost in the revenue per path cost [m]."""
TAKEN_RADIUS = 0.4
"""Minimum distance of an assigned frontier point from the frontiers of other robots [m]."""


def assign(
    grid: OccupancyGrid,
    robots: np.ndarray,
    points: np.ndarray,
    costs: np.ndarray,
    params: RrtParams,
    taken: np.ndarray = NO_POINTS,
) -> np.ndarray:
    """Assign frontier points to robots by descending revenue (Nguyen et al. 2022, section 2.1.3).

    The revenue is R = lambda h(x_fp, x_r) I(x_fp) - N(x_fp), with unknown area I around point x_fp, path cost N, robot
    position x_r, and lambda = `info_multiplier`. h is `hysteresis_gain` within `hysteresis_radius` and 1 beyond.
    Unknown cells near assigned points do not count again. With `view_radius`, R = I / (N + `LEAST_COST`), and I is the
    unknown area in view (González-Baños and Latombe 2002).

    `robots`: positions, shape (n, 2). `points`: frontier points, shape (m, 2). `taken`: points of other robots, shape
    (k, 2), all map frame [m]. `costs`: path costs [m], shape (n, m), inf without a path.

    Returns:
        Index of the point of each robot, shape (n,), int64, -1 for none.
    """
    chosen = np.full(len(robots), UNASSIGNED, dtype=np.int64)
    area, radius = (visible_gain, params.view_radius) if params.view_radius else (information_gain, params.info_radius)
    gains = area(grid, points, radius)
    for point in taken:
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=point)
    gaps = robots[:, None] - points[None]
    is_near = np.hypot(gaps[..., 0], gaps[..., 1]) <= params.hysteresis_radius
    factors = params.info_multiplier * np.where(is_near, params.hysteresis_gain, 1.0)
    open_costs = costs.astype(np.float64)
    for _ in range(min(len(robots), len(points))):
        revenues = factors * gains - open_costs
        if params.view_radius:
            revenues = np.where(np.isinf(open_costs), -np.inf, gains / (open_costs + LEAST_COST))
        robot, point = np.unravel_index(np.argmax(revenues), revenues.shape)
        if math.isinf(revenues[robot, point]):
            break
        chosen[robot] = point
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=points[point])
        open_costs[robot] = open_costs[:, point] = np.inf
    return chosen


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


class RrtTeam(TeamExplorer):
    """Drives a team of robots to frontier points found by random trees."""

    def __init__(self, params: RrtParams = TEAM_PARAMS) -> None:
        super().__init__(period=params.period)
        self._params = params
        self._detector: RrtDetector | None = None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._detector = RrtDetector(self._params, rng)

    @property
    def markers(self) -> Markers | None:  # type: ignore[override]
        markers, detector = super().markers, self._detector
        if markers is None or detector is None:
            return None
        trees = [tree.edges for tree in reversed(detector.trees)]
        return markers._replace(clusters=detector.points, points=detector.found, trees=trees)

    def _make_robot(self, index: int) -> RrtRobot:
        return RrtRobot(self._robot, self._control_period, self._params, index)

    def _look(self, team: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> None:
        assert self._detector is not None
        self._detector.detect(beliefs[0].grid, [belief.pose[:2] for belief in beliefs])
        for robot in team:
            assert isinstance(robot, RrtRobot)
            robot.points = self._detector.points
            # Trees may miss the current point for some steps.
            if math.isfinite(self.period) and robot.driving_to:
                robot.points = np.vstack([robot.points, robot.driving_to])

    def _command(self, robot: TeamRobot, belief: Belief) -> Twist:
        return super()._command(robot, belief) if self._params.pursuit else robot.command(belief)

    def _assign(self, due: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> list[int]:
        assert self._navigator is not None
        columns: dict[tuple[float, float], int] = {}
        goals: list[tuple[np.ndarray, ...]] = []
        for robot in due:
            indices = np.flatnonzero(robot.candidates["failures"] == 0)
            if len(indices) == 0:
                indices = np.arange(len(robot.candidates))
            goals.append((robot.candidates["frontier"][indices], robot.candidates["cost"][indices], indices))
            for x, y in goals[-1][0].tolist():
                columns.setdefault((x, y), len(columns))
        costs = np.full((len(due), len(columns)), np.inf)
        for row, (frontiers, lengths, indices) in enumerate(goals):
            turns = self._params.turn_cost * np.abs(due[row].candidates["turn"][indices])
            costs[row, [columns[x, y] for x, y in frontiers.tolist()]] = lengths + turns
        points = np.array(list(columns)).reshape(-1, 2)
        # During a drive, a robot may keep its point.
        keeps = due if math.isfinite(self.period) else ()
        others = [robot.driving_to for robot in self._navigator.team if robot not in keeps]
        taken = np.array([target for target in others if target]).reshape(-1, 2)
        gaps = points[:, None] - taken
        costs[:, (np.hypot(gaps[..., 0], gaps[..., 1]) <= TAKEN_RADIUS).any(axis=1)] = np.inf
        positions = np.array([beliefs[robot.index].pose[:2] for robot in due]).reshape(-1, 2)
        chosen = assign(beliefs[0].grid, positions, points, costs, self._params, taken)
        return [
            int(indices[(frontiers == points[point]).all(axis=1).argmax()]) if point != UNASSIGNED else UNASSIGNED
            for (frontiers, _, indices), point in zip(goals, chosen, strict=True)
        ]


class RrtExplorer(RrtTeam):
    """Drives one robot to frontier points found by random trees."""

    is_team = False

    def __init__(self, params: RrtParams = RrtParams()) -> None:
        super().__init__(params)

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        return next(iter(self.plans), None)

    def act(self, reading: Reading, belief: Belief) -> Twist:  # type: ignore[override]
        return super().act([reading], [belief])[0]
