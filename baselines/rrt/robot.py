"""One robot that explores by frontier points: its navigator, the right of way, and how it drives, yields and waits."""

import math

import numpy as np

from baselines.rrt.detector import RrtParams
from envs.estimation import Belief
from envs.geometry import Pose2D
from envs.geometry.distance_transform import squared_distances
from envs.geometry.lines import lengths_along
from envs.navigation import COST_MAX_FREE, COST_UNKNOWN, NO_POINTS, FrontierNavigator, TravelField, travel_field
from envs.navigation.navigator_kernels import DRIVING, REPLAN
from envs.navigation.planning_map import CostLayer
from envs.robots import RobotParams
from envs.simulation import Reading

PASSING_CLEARANCE = 0.15
"""Gap between the footprints of a robot that passes and of one that waits [m]."""
OUTLINE_POINTS = 16
"""Points on the outline of a peer."""
PAUSE_TIME = 1.0
"""Time between two searches for a point, while a robot has none and others have [s]."""
BLOCKED_TIME = 1.0
"""Time without progress after which a robot is blocked [s]."""
PASSED_CLEARANCE = 0.5
"""Gap between the footprint of a waiting robot and the path of the other one from which that one has passed [m]."""
MAX_WAIT = 15.0
"""Longest time to wait [s]."""


def outline(pose: Pose2D, peer: Pose2D, radius: float) -> np.ndarray:
    """Return the outline of a peer, of a radius [m], as obstacles: shape (16, 2), float64, the robot's base frame [m].

    The poses of the robot and of the peer are those in the map frame.
    """
    away = pose.between(peer)
    angles = np.linspace(0.0, 2.0 * math.pi, OUTLINE_POINTS, endpoint=False)
    return np.array(away[:2]) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def is_beside(position: tuple[float, float], path: np.ndarray, gap: float, reach: float = math.inf) -> bool:
    """Tell whether a position lies within `gap` [m] of the first `reach` metres of a path, shape (n, 2)."""
    if len(path) == 0:
        return False
    near = path[lengths_along(path) <= reach]
    return bool(np.hypot(*(near - position).T).min() < gap)


def find_waiting_cell(field: TravelField, path: np.ndarray, radius: float) -> tuple[int, int] | None:
    """Return where a robot waits for another one to pass: the cell off that one's path that is cheapest to get to.

    `field` is the travel of the waiting robot, with the other one as an obstacle; `path`, shape (n, 2), n > 0, map
    frame [m], begins at the other one; both footprints have a radius [m]. None if there is no such cell.
    """
    grid = field.costmap.grid
    cells = grid.cells(path)
    cells = cells[grid.contains(cells)]
    on_path = np.zeros(grid.data.shape, dtype=np.bool_)
    on_path[cells[:, 0], cells[:, 1]] = True
    reach = math.ceil((2.0 * radius + PASSING_CLEARANCE) / grid.resolution)
    off_path = np.argwhere(squared_distances(on_path, reach) > reach**2)
    costs = field.cost(off_path)
    if len(costs) == 0 or math.isinf(costs.min()):
        return None
    row, col = off_path[np.argmin(costs)]
    return int(row), int(col)


class RrtRobot(FrontierNavigator):
    """Offers, for each valid frontier point, the frontier cell nearest to it, and decides how to get there."""

    def __init__(self, robot: RobotParams, control_period: float, params: RrtParams, index: int) -> None:
        """Prepare for an episode of a robot with an index in its team, updated every `control_period` seconds."""
        super().__init__(robot, control_period)
        self.index = index
        self.points = NO_POINTS
        """Frontier points, shape (n, 2), float64, map frame [m]."""
        self.ended: str | None = None
        """Why it has stopped exploring; None while it has not."""
        self.yielding_to: RrtRobot | None = None
        """The robot that it lets pass."""
        self.passing = NO_POINTS
        """Outlines of the peers that plans lead through, and not around, as those in `bodies`; base frame [m]."""
        self._params, self._radius, self._period = params, robot.radius, control_period
        self._has_begun = self._has_looked_around = False
        self._idle_steps = self._pause_steps = self._wait_steps = 0

    @property
    def driving_to(self) -> tuple[float, float] | None:
        """The frontier that it drives to (x, y), map frame [m]; None without one."""
        return self.target if self.navigator.has_goal and self.yielding_to is None else None

    @property
    def precedence(self) -> tuple[bool, int]:
        """The robot with the lower one has the right of way."""
        return self.driving_to is None, self.index

    @property
    def is_blocked(self) -> bool:
        """Whether it drives to a goal and makes no progress."""
        drive = self.navigator
        return drive.has_goal and not drive.is_recovering and drive.record["stall_steps"] * self._period > BLOCKED_TIME

    @property
    def is_idle(self) -> bool:
        """Whether it has begun, and has nothing to do."""
        is_busy = self.navigator.has_goal or self.navigator.is_recovering or self.yielding_to is not None
        return self._has_begun and not is_busy

    def advance(self, reading: Reading, belief: Belief, *, is_asked: bool) -> bool:
        """Process a reading, without peers, and tell whether the robot is to be assigned one of the frontier points.

        A robot that `is_asked` looks for one even in a pause.
        """
        self._idle_steps = 0 if self.driving_to is not None else self._idle_steps + 1
        self._pause_steps -= 1
        others = np.concatenate([self.bodies, self.passing])
        if not self._has_begun:
            self._has_begun = True
            self.begin(reading, belief)
            return True
        if self.yielding_to is not None:
            if self.drive(reading, belief, others) not in (DRIVING, REPLAN):
                self.navigator.stop()
            if not self._has_passed(self.yielding_to, belief.pose):
                return False
            self.yielding_to = None
            self.navigator.stop()
        elif self.is_idle and self._pause_steps > 0 and not is_asked:
            self.drive(reading, belief, others)
            return False
        return self.update(reading, belief, others) is not None

    def learn(self, belief: Belief) -> None:
        """Take note of what another robot's scan has changed in the map."""
        if self._has_begun:
            self.integrate(belief)

    def open_goals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what may be assigned: candidates that have failed only if there are no others.

        These are frontiers, shape (k, 2), map frame [m], the costs of the paths to their viewpoints [m], and their
        indices among the candidates.
        """
        candidates = self.candidates
        indices = np.flatnonzero(candidates["failures"] == 0)
        if len(indices) == 0:
            indices = np.arange(len(candidates))
        return candidates["frontier"][indices], candidates["cost"][indices], indices

    def choose(self, index: int) -> None:
        """Drive to a candidate."""
        self._has_looked_around, self.ended = False, None
        super().choose(index)

    def wait(self) -> None:
        """Stop for a while, since others have all the points."""
        self._has_looked_around, self.ended = False, None
        self.navigator.stop()
        self._pause_steps = max(1, round(PAUSE_TIME / self._period))

    def look_around_or_end(self) -> None:
        """Turn once around where no point is left; then end, if there has been none for `patience` steps."""
        if not self._has_looked_around:
            self._has_looked_around = True
            self.look_around()
        elif self._idle_steps >= self._params.patience:
            self.ended = self.end_reason
            self.navigator.stop()

    def yield_to(self, other: "RrtRobot", pose: Pose2D) -> bool:
        """Drop the own goal and drive off the path of another robot; False if there is nowhere to go."""
        path = other.plan
        field = None if path is None else travel_field(self.free_costmap(pose), pose[:2])
        cell = None if path is None or field is None else find_waiting_cell(field, path, self._radius)
        route = None if field is None or cell is None else field.path(*cell)
        if route is None:
            return False
        self.navigator.drive_to(route)
        self.yielding_to, self._wait_steps = other, 0
        return True

    def _has_passed(self, other: "RrtRobot", pose: Pose2D) -> bool:
        path = other.plan
        if path is None:
            return True
        if self.navigator.has_goal:
            return False
        self._wait_steps += 1
        is_off = not is_beside(pose[:2], path, 2.0 * self._radius + PASSED_CLEARANCE)
        return is_off or self._wait_steps * self._period > MAX_WAIT

    def _frontiers(self, layer: CostLayer) -> tuple[np.ndarray, np.ndarray]:
        """Return frontier cells, shape (k, 2), and one part for each, shape (k, 4); see `split_groups`."""
        planning, side = self.map, self.map.side
        positions = (self.points[:, ::-1] - planning.origin[::-1]) / side  # row, column
        cells = np.floor(positions).astype(np.int64)
        is_inside = ((cells >= 0) & (cells < planning.joined.shape)).all(axis=1)
        costs = np.full(len(cells), COST_UNKNOWN, dtype=np.uint8)
        costs[is_inside] = layer.costs[tuple(cells[is_inside].T)]
        # On the scale on which ROS publishes costmaps: 1 to 98 near obstacles, 99 where the footprint touches one.
        near = 1.0 + np.floor(97.0 * (costs - 1.0) / 251.0)
        on_ros_scale = np.select([(costs == 0) | (costs == COST_UNKNOWN), costs > COST_MAX_FREE], [0.0, 99.0], near)
        nearest = self._nearest_frontier(positions[on_ros_scale <= self._params.max_cost])
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
