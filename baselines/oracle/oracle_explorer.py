import numpy as np

from lidarnaut.baselines.frontier.rules import NearestExplorer
from lidarnaut.baselines.oracle.cover_planner import CoverPlanner
from lidarnaut.baselines.oracle.cover_viewpoints import find_viewpoints
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OCCUPIED, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.lines import resample
from lidarnaut.envs.navigation import Navigator, PlanningMap, crop_to_known, make_costmap, plan_path
from lidarnaut.envs.navigation.controllers.navigator_kernels import DRIVING, FAILED, REACHED, REPLAN, SPUN
from lidarnaut.envs.navigation.policy import Explorer
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist
from lidarnaut.envs.tasks.coverage import Coverage

DECISION_PERIOD = 1.0
"""Time between two updates of the tour of viewpoints [s]."""
NUM_FIRST_ROUNDS = 300
NUM_ROUNDS = 4
LOOKAHEAD = 3.0
"""Minimum path length to the driving goal, the first such viewpoint on the path to the next tour stop [m]. If there is
none, the stop is the goal."""
ARRIVAL_RADIUS = 0.15
"""Distance from a viewpoint within which the viewpoint counts as visited [m]."""
REACH_MARGIN = 0.1
"""Reduction of the lidar range assumed in tour planning [m]."""
GOAL_TOLERANCE = 0.4
"""Maximum distance between a viewpoint and the end of the path to this viewpoint [m]."""


class TrueMap:
    """True map in the frame of the estimated map, to fill in unknown cells of the estimated map."""

    def __init__(self, walls: OccupancyGrid, start: Pose2D) -> None:
        self._walls, self._start = walls, start
        self._grid: OccupancyGrid | None = None

    def complete(self, grid: OccupancyGrid) -> OccupancyGrid:
        truth = self._aligned(grid)
        shift = np.rint((np.array(grid.origin) - truth.origin)[::-1] / truth.resolution).astype(int)
        low = np.maximum(shift, 0)
        high = np.minimum(shift + grid.data.shape, truth.data.shape)
        data = truth.data.copy()
        if (high > low).all():
            window = data[low[0] : high[0], low[1] : high[1]]
            known = grid.data[low[0] - shift[0] : high[0] - shift[0], low[1] - shift[1] : high[1] - shift[1]]
            np.copyto(window, known, where=known >= 0)
        return OccupancyGrid(data, truth.resolution, truth.origin)

    def _aligned(self, grid: OccupancyGrid) -> OccupancyGrid:
        if self._grid is None:
            x_min, y_min, x_max, y_max = self._walls.bounds
            corners = np.array([[x_min, y_min], [x_min, y_max], [x_max, y_min], [x_max, y_max]])
            corners = self._start.inverse().transform(corners)
            resolution, origin = grid.resolution, np.array(grid.origin)
            low = np.floor((corners.min(axis=0) - origin) / resolution)
            width, height = np.ceil((corners.max(axis=0) - origin) / resolution).astype(int) - low.astype(int)
            x, y = (origin + low * resolution).tolist()
            data = np.full((height, width), OCCUPIED, dtype=np.int8)
            self._grid = OccupancyGrid(data, resolution, (x, y))
            centers = self._grid.centers(np.argwhere(data >= 0))
            cells = self._walls.cells(self._start.transform(centers))
            inside = self._walls.contains(cells)
            data.reshape(-1)[inside] = self._walls.data[tuple(cells[inside].T)]
        return self._grid


class OracleExplorer(Explorer):
    """Explorer that knows the true map and drives a short tour that observes the area.

    Paths are planned on the estimated map, with true values in unknown cells.
    """

    def __init__(self) -> None:
        self._rest = NearestExplorer()
        self._coverage: Coverage | None = None

    @property
    def end_reason(self) -> str | None:  # type: ignore[override]
        return self._rest.end_reason

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        return self._rest.plan if self._is_done or self._map is None else self._navigator.plan

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._rng = robot, rng
        self._navigator = Navigator(robot, control_period)
        self._rest.reset(robot, control_period, rng)
        self._decision_steps = max(1, round(DECISION_PERIOD / control_period))
        self._countdown = 0
        self._progress = SPUN
        self._map: PlanningMap | None = None
        self._coverage = None
        self._planner: CoverPlanner | None = None
        self._goal = -1
        self._is_done = False

    def reveal(self, coverage: Coverage, target_coverage: float) -> None:
        self._coverage, self._target_coverage, self._start = coverage, target_coverage, coverage.start
        self._truth = TrueMap(coverage.area.walls, coverage.start)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        if self._coverage is None:
            raise RuntimeError("call reset and reveal before act, as run_episode does")
        if self._is_done:
            return self._rest.act(reading, belief)
        navigator = self._navigator
        if self._map is None:
            self._map = PlanningMap(self._robot, belief.grid.resolution)
            navigator.sense(reading)
        else:
            self._progress = navigator.update(reading, belief.pose)
        self._countdown -= 1
        is_driving = self._progress in (DRIVING, REPLAN) and self._countdown > 0
        if not (navigator.is_recovering or is_driving):
            self._countdown = self._decision_steps
            self._is_done = not self._decide(belief, self._map, self._coverage)
            if self._is_done:
                return self._rest.act(reading, belief)
        return navigator.command(belief.pose)

    def _decide(self, belief: Belief, planning: PlanningMap, coverage: Coverage) -> bool:
        num_rounds = NUM_ROUNDS if self._planner else NUM_FIRST_ROUNDS
        planner = self._planner = self._planner or self._prepare(planning, coverage)
        if planner is None:
            return False
        x, y, _ = self._start.compose(belief.pose)
        planning.update(self._truth.complete(belief.grid), None)
        if self._progress == FAILED and planner.stops:
            planner.leave_out(planner.stops[0])
        for viewpoint in np.flatnonzero(np.hypot(*(planner.viewpoints.points - (x, y)).T) < ARRIVAL_RADIUS):
            planner.use_up(int(viewpoint), coverage.explored)
        while True:
            planner.plan(x, y, coverage.explored, num_rounds)
            num_rounds = NUM_ROUNDS
            if not planner.stops:
                return False
            stop = planner.stops[0]
            if self._progress == REACHED and self._goal == stop:
                planner.use_up(stop, coverage.explored)
            elif self._drive_on(planner, planning, belief.pose):
                return True
            else:
                planner.leave_out(stop)

    def _prepare(self, planning: PlanningMap, coverage: Coverage) -> CoverPlanner | None:
        reach, (x, y, _) = max(self._robot.lidar.range_max - REACH_MARGIN, 0.0), self._start
        walls, first = crop_to_known(coverage.area.walls), None
        for tables in planning.tables:
            costmap = make_costmap(walls, planning.params.costmap(tables.robot_radius))
            viewpoints = find_viewpoints(costmap, (x, y))
            if viewpoints is None:
                continue
            planner = CoverPlanner(coverage.area, viewpoints, reach, self._target_coverage, self._rng)
            if planner.plan(x, y, coverage.explored, 0):
                return planner
            first = first or planner
        return first

    def _drive_on(self, planner: CoverPlanner, planning: PlanningMap, pose: Pose2D) -> bool:
        x, y, _ = self._start.compose(pose)
        goal = planner.next_viewpoint(x, y, LOOKAHEAD)
        point = self._start.inverse().transform(planner.viewpoints.points[goal])
        for level in range(len(planning.tables)):
            costmap = planning.costmap(level, pose, self._navigator.obstacles)
            path = plan_path(costmap, pose[:2], tuple(point.tolist()), tolerance=GOAL_TOLERANCE)
            if path is not None:
                # The progress checker keeps its timers for an unchanged goal.
                is_same = goal == self._goal and self._progress in (DRIVING, REPLAN)
                self._navigator.drive_to(resample(path, 0.05), keep_clocks=is_same)
                self._goal = goal
                return True
        return False
