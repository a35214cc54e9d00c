"""Navigation from frontier to frontier, for explorers and for `ExploreFrontiers-v0`."""

import math

import numpy as np
from scipy.spatial import cKDTree

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation.maps.planning_params import NavigatorParams, PlanningParams
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

from ..controllers.navigator import NO_POSITION, Navigator
from ..controllers.navigator_kernels import DRIVING, FAILED, REACHED, REPLAN, SPUN, TIME_UP, WELL_IN_VIEW
from ..maps.costmap import COST_INSCRIBED, Costmap
from ..maps.obstacles import NO_POINTS
from ..maps.planning_map import CostLayer, PlanningMap
from ..search.astar import UNREACHED
from ..search.paths import exits, nearest_cell, search_goal, travel_field, write_path
from .candidates import CANDIDATE, MAX_FAILURES, Candidates, describe, fill_features, find_candidates
from .frontiers import frontier_groups, frontier_in_sight, frontier_near, split_groups
from .memory import RETRY_RADIUS, FrontierMemory, PeopleNearby

ARRIVED, FRONTIER_GONE, DRIVE_TIME_UP, LOOKED_AROUND = "arrived", "frontier_gone", "time_up", "looked_around"
STILL_DISTANCE, STILL_TIME = 0.1, 30.0
"""The robot counts as stuck if it moves less than this distance [m] in this time [s] and no frontier is left."""
FAILURE_RADIUS, MAX_FAILURE_RADIUS = 3.0, 0.75
"""Radius of the area around a frontier that is ignored after `MAX_FAILURES` failed drives, in robot radii, and maximum
[m]. After a visit, visible frontier cells up to this distance beyond the frontier are ignored."""
MAX_LOOKS = 40
"""Maximum number of retries per episode when people may have blocked the passage to the last frontiers."""
EXIT_REACH, MAX_EXITS = 0.3, 3
"""Maximum length [m] of drives out of a mapped obstacle, and maximum number of successive drives."""
OUTCOMES = {REACHED: ARRIVED, FAILED: "failed", TIME_UP: DRIVE_TIME_UP, SPUN: LOOKED_AROUND}


class FrontierNavigator:
    """Finds reachable frontiers (candidates), drives to a chosen candidate, and reports the end of each drive.

    Each control period, call `update`, then `command`. After the end of a drive, call `choose` with the index of a
    candidate. Without candidates, exploration is over. Never uses ground truth.
    """

    candidates: Candidates = None  # type: ignore[assignment]
    """Reachable frontiers; None before `begin`."""

    def __init__(
        self,
        robot: RobotParams,
        control_period: float,
        *,
        max_candidates: int | None = None,
        max_time: float = math.inf,
        planning: PlanningParams = PlanningParams(),
        params: NavigatorParams = NavigatorParams(),
    ) -> None:
        """Create a navigator.

        `control_period`: time between calls of `update` [s]. `max_candidates`: maximum number of reachable frontiers,
        cheapest first; None for all. `max_time`: maximum drive time [s].
        """
        self.navigator = Navigator(robot, control_period, params, max_time=max_time)
        self.robot, self.params, self._planning_params = robot, params, planning
        self._max_candidates = max_candidates if max_candidates is not None else 1 << 30
        self._min_steps = max(1, round(params.min_time / control_period))
        self._look_radius = min(FAILURE_RADIUS * robot.radius, MAX_FAILURE_RADIUS)
        self.bodies = NO_POINTS
        """Obstacle points missing from the map, such as other robots, shape (n, 2), float64, base frame [m]."""

    def begin(self, reading: Reading, belief: Belief) -> None:
        """Begin an episode and find the first reachable frontiers."""
        self.map = PlanningMap(self.robot, belief.grid.resolution, self._planning_params)
        self._lengths = tuple(max(1, round(length / self.map.side)) for length in self._planning_params.min_lengths)
        self.navigator.reset()
        self.navigator.sense(reading)
        self._level = 0
        self._memory, self._people = FrontierMemory(), PeopleNearby()
        self._position, self._now, self._there_since = (math.inf, math.inf), 0.0, 0.0
        self.target: tuple[float, float] | None = None
        """Last chosen frontier (x, y), map frame [m]."""
        self._last_failed = False
        # Whether to check again that the chosen frontier exists.
        self._has_changed = True
        self._has_start = True
        self._is_looking = False  # turns at a viewpoint
        self._is_approaching, self._num_exits = False, 0
        self._outcome: str | None = None
        self.integrate(belief)
        self._find(belief.pose)

    @property
    def plan(self) -> np.ndarray | None:
        return self.navigator.plan

    @property
    def failures(self) -> np.ndarray:
        """Frontiers of failed drives, shape (n, 2), map frame [m]."""
        return self._memory.failures

    @property
    def end_reason(self) -> str:
        """Reason why no frontier is left: `"no_reachable_frontier"`, or `"stuck"` if the robot could not move."""
        is_still = self._now - self._there_since > STILL_TIME
        return "stuck" if not self._has_start or is_still or self._is_enclosed() else "no_reachable_frontier"

    def _is_enclosed(self) -> bool:
        field = travel_field(self.candidates.costmap, self._position)
        reached = np.argwhere(np.isfinite(field.costs)) if field is not None else np.empty((0, 2))
        gaps = self.map.grid.centers(reached) - self._position
        return bool((np.hypot(*gaps.T) <= self.params.stuck_distance).all())

    def write_features(self, pose: Pose2D, features: np.ndarray, sectors: np.ndarray, gaps: np.ndarray) -> None:
        fill_features(self.candidates.table, self.candidates.chosen, *pose, features, sectors, gaps)

    def choose(self, index: int, *, keep_clocks: bool = False) -> None:
        """Begin a drive to a reachable frontier.

        `index`: in `candidates`. `keep_clocks`: continue the time limits of the last drive.
        """
        self._has_changed, self._is_looking = True, False
        path, candidate = self.path_to(index), self.candidates.table[index]
        self.target = view = float(candidate["frontier"][0]), float(candidate["frontier"][1])
        self.navigator.drive_to(path, tuple(candidate["viewpoint"].tolist()), view=view, keep_clocks=keep_clocks)

    def path_to(self, index: int) -> np.ndarray:
        """Return the path to a reachable frontier, shape (n, 2), float64, map frame [m].

        `index`: in `candidates`. Valid until the next path search.
        """
        row, col = self.candidates["goal"][index].tolist()
        return self._path(self.candidates.costmap.costs, (row, col))

    def look_around(self) -> None:
        """Spin once on the spot instead of driving."""
        self._outcome, self._is_looking = None, False
        self.navigator.spin()

    def command(self, belief: Belief) -> Twist:
        return self.navigator.command(belief.pose)

    def update(self, reading: Reading, belief: Belief, others: np.ndarray = NO_POINTS) -> str | None:
        """Process a sensor reading; return why the drive has ended, such as `"arrived"`; None while it continues.

        After the end of a drive, choose a new frontier. `others`: points on other robots, shape (m, 2), base frame [m].
        """
        return self.conclude(self.drive(reading, belief, others), reading, belief)

    def conclude(self, progress: int, reading: Reading, belief: Belief) -> str | None:
        """Return why the drive has ended, such as `"arrived"`, or None. `progress`: status returned by `drive`."""
        self._now = reading.time
        self._people.update(belief)
        outcome = self._judge(progress, belief.pose)
        if outcome is None:
            return None
        goes_on, self._is_approaching = self._is_approaching and outcome == DRIVE_TIME_UP, False
        self._find(belief.pose)
        if outcome != LOOKED_AROUND and len(self.candidates) == 0 and not goes_on:
            self._outcome = outcome
            self.navigator.spin()
            return None
        if len(self.candidates) == 0 and (self._drive_out(belief.pose) or self._look_again(goes_on)):
            return None
        if outcome == LOOKED_AROUND and self._outcome is not None:
            outcome, self._outcome = self._outcome, None
        return outcome

    @property
    def _obstacles(self) -> np.ndarray:
        return self._people.without_walking(self.navigator.obstacles)

    def _drive_out(self, pose: Pose2D) -> bool:
        self._num_exits = 0 if self._has_start else self._num_exits + 1
        if self._has_start or self._num_exits > MAX_EXITS:
            return False
        costmap = self.map.costmap(len(self.map.tables) - 1, pose)
        least = float(self.navigator.numbers["goal_tolerance"])
        found = exits(costmap, pose, self.navigator.obstacles, EXIT_REACH, least + self.map.side)
        if found:
            self.navigator.drive_to(found[0])
            self._is_approaching = True
        return bool(found)

    def _look_again(self, goes_on: bool) -> bool:
        planning, memory, met = self.map, self._memory, self._people.met
        is_left = planning.frontier.any() or len(memory.given_up) > 0
        if memory.num_looks == MAX_LOOKS or not len(met) or not is_left:
            return False
        memory.num_looks += not goes_on
        planning.look_again_at(memory.given_up)
        memory.given_up = memory.failures = NO_POINTS
        height, width = planning.occupancy.shape
        if not self._has_start:
            self.navigator.spin()
            return True
        reached = np.argwhere(planning.expansion.travel.reshape(height + 2, width + 2)[1:-1, 1:-1] < UNREACHED)
        gaps, nearest = cKDTree(planning.grid.centers(reached)).query(met)
        gaps[gaps < planning.side] = math.inf  # reachable, so not a blocked passage
        k = int(gaps.argmin())
        if math.isfinite(gaps[k]):
            row, col = reached[nearest[k]].tolist()
            path = self._path(self.candidates.costmap.costs, (row, col))
            if math.dist(path[0], path[-1]) > self.params.stuck_distance:
                self.navigator.drive_to(path)
                self._is_approaching = True
                return True
        self.navigator.spin()
        return True

    def look(self, reading: Reading, belief: Belief) -> None:
        """Update map, obstacles and reachable frontiers with a sensor reading, without ending the current drive."""
        self.integrate(belief)
        self.navigator.sense(reading)
        self.find_candidates(reading, belief)

    def find_candidates(self, reading: Reading, belief: Belief) -> None:
        """Find reachable frontiers with the current map and pose estimate."""
        self._now = reading.time
        self._find(belief.pose)

    @property
    def check_from(self) -> float:
        """Number of control periods before a vanished frontier may end the drive; inf while the map is unchanged."""
        return self._min_steps if self._has_changed else math.inf

    def drive(self, reading: Reading, belief: Belief, others: np.ndarray = NO_POINTS) -> int:
        """Update the navigator with a sensor reading in each control period of a drive; return the drive's status."""
        self.integrate(belief)
        return self.navigator.update(reading, belief.pose, others)

    def fail(self) -> None:
        """Stop the drive and count a failed drive to the chosen frontier."""
        self._fail()
        self._last_failed = True
        self.navigator.stop()

    def free_costmap(self, pose: Pose2D) -> Costmap:
        """Return the costmap for the largest footprint radius without a collision at a pose."""
        for level in range(len(self.map.tables)):
            costmap = self.map.costmap(level, pose, self._obstacles, self.bodies)
            if costmap.costs[self.map.cell(pose.x, pose.y)] < COST_INSCRIBED:
                break
        return costmap

    def integrate(self, belief: Belief) -> None:
        """Update the planning map with changes by the last scan."""
        update = belief.update
        if update.redrawn:
            if (correction := update.correction) is not None:
                # Stored positions move with the map.
                self._memory.correct(correction)
                self.map.ignored_points = correction.apply(self.map.ignored_points)
                if self.target is not None:
                    x, y = correction.apply(np.array([self.target]))[0].tolist()
                    self.target = (x, y)
            self.navigator.follow_redrawn_map(correction)
        self.map.update(belief.grid, update.window, redrawn=update.redrawn)
        self._has_changed |= update.window is not None or update.redrawn

    def _judge(self, progress: int, pose: Pose2D) -> str | None:
        navigator = self.navigator
        is_due = self._has_changed and navigator.record["steps"] >= self._min_steps
        if is_due and navigator.has_goal and not navigator.is_recovering and not self._is_approaching:
            self._has_changed = False
            if not self._is_frontier_left():
                self._last_failed = False
                return FRONTIER_GONE
        if self._is_looking:
            if progress != SPUN and self._is_frontier_left():
                return None
            navigator.stop()
            progress = REACHED
        if progress == REPLAN:
            progress = DRIVING if self._replan(pose) else FAILED
        if progress == DRIVING:
            return None
        if progress == FAILED and not self._is_approaching:
            self._fail()
        elif progress == REACHED and not self._is_approaching:
            if not self._ignore_in_sight(pose):
                self._is_looking = True
                navigator.spin(2.0 * (math.pi - float(navigator.numbers["half_fov"])))
                return None
            self._is_looking = False
        if progress != SPUN:
            self._last_failed = progress == FAILED
        return OUTCOMES[progress]

    def _is_frontier_left(self) -> bool:
        assert self.target is not None
        return self.map.is_frontier_near(self.target, self.params.frontier_radius)

    def _start_cell(self, layer: CostLayer, pose: Pose2D) -> tuple[int, int]:
        tables, cell = layer.tables, self.map.cell(pose.x, pose.y)
        row, col = nearest_cell(layer.costs, tables.weights, *cell, tables.radius, COST_INSCRIBED)
        return row, col

    def _find(self, pose: Pose2D) -> None:
        if math.dist(pose[:2], self._position) >= STILL_DISTANCE:
            self._position, self._there_since = pose[:2], self._now
        planning = self.map
        planning.refresh()
        self._has_start = False
        for level in range(len(planning.tables)):
            layer = planning.layer(level, pose, self._obstacles, self.bodies)
            cells, parts = self._frontiers(layer)
            start = self._start_cell(layer, pose)
            table = np.empty(0, dtype=CANDIDATE)
            if start[0] >= 0:
                self._has_start = True
                workspace = planning.expansion, planning.queue
                costs, frontier = (layer.costs, layer.open_weights), (cells, parts)
                limits = self._lengths, self._max_candidates
                found, planning.queue = find_candidates(
                    planning.occupancy, costs, *workspace, start, frontier, *limits, layer.tables
                )
                # Later rounds may find cheaper candidates. Sorting in the kernel would compile slowly.
                table = found[np.argsort(found["travel"], kind="stable")[: self._max_candidates]]
            if len(table):
                break
        self._level = level
        height, width = planning.occupancy.shape
        raster = planning.occupancy, planning.expansion.predecessor.reshape(height + 2, width + 2)
        past = self._memory.known, self.failures, self.target or NO_POSITION, RETRY_RADIUS
        frame = *planning.origin, planning.side
        self._memory.known, chosen = describe(raster, table, layer.tables, frame, pose.theta, self._now, past)
        costmap = Costmap(layer.costs, planning.grid, layer.params)
        self.candidates = Candidates(table, int(chosen), self._last_failed, cells, costmap)

    def _frontiers(self, layer: CostLayer) -> tuple[np.ndarray, np.ndarray]:
        cells, starts = frontier_groups(self.map.frontier, self.map.tile_counts)
        return cells, split_groups(cells, starts, layer.tables.max_extent, min(self._lengths))

    def _replan(self, pose: Pose2D) -> bool:
        planning = self.map
        layer = planning.layer(self._level, pose, self._obstacles, self.bodies)
        start = self._start_cell(layer, pose)
        if start[0] < 0:
            return False
        slack = math.floor(self.navigator.numbers["goal_tolerance"] / planning.side + 1e-9)
        goal, arrays = planning.cell(*self.navigator.goal), (layer.costs, layer.open_weights)
        workspace = planning.expansion, planning.queue
        end, planning.queue = search_goal(arrays, layer.tables.weights, *workspace, start, goal, slack)
        if end[0] < 0:
            return False
        self.navigator.follow(self._path(layer.costs, end))
        return True

    def _path(self, costs: np.ndarray, cell: tuple[int, int]) -> np.ndarray:
        planning, weights = self.map, self.map.tables[self._level].weights
        path: np.ndarray = write_path(costs, weights, planning.expansion, cell, planning.side, planning.origin)
        return path

    def _fail(self) -> None:
        assert self.target is not None
        if self._memory.add_failure(self.target) >= MAX_FAILURES:
            planning = self.map
            planning.refresh()
            reach = math.ceil(self._look_radius / planning.side - 1e-9)
            given_up = planning.grid.centers(frontier_near(planning.frontier, *planning.cell(*self.target), reach))
            self._memory.given_up = np.vstack([self._memory.given_up, given_up])
            planning.ignore(given_up)

    def _ignore_in_sight(self, pose: Pose2D) -> bool:
        if not self._is_frontier_left():
            return True
        assert self.target is not None
        planning, numbers = self.map, self.navigator.numbers
        planning.refresh()
        reach = math.ceil((math.dist(self.target, pose[:2]) + self._look_radius) / planning.side - 1e-9)
        at = (pose.y - planning.origin[1]) / planning.side, (pose.x - planning.origin[0]) / planning.side
        middle, half_fov = pose.theta + float(numbers["mount"][2]), float(numbers["half_fov"])
        has_looked = self._is_looking or bool(numbers["sees_around"])
        view = middle, math.pi if has_looked else half_fov
        in_sight = frontier_in_sight(planning.occupancy, planning.frontier, at, view, reach)
        # Always ignore the visited frontier, or the robot would return forever.
        row, col = planning.cell(*self.target)
        reach = math.ceil(self.params.frontier_radius / planning.side - 1e-9)
        all_around = (row + 0.5, col + 0.5), (0.0, math.pi)
        beside = frontier_in_sight(planning.occupancy, planning.frontier, *all_around, reach)
        cells = np.vstack([in_sight, [(row, col)], beside])
        away = np.cos(np.arctan2(cells[:, 0] + 0.5 - at[0], cells[:, 1] + 0.5 - at[1]) - middle)
        if not has_looked and (away < math.cos(WELL_IN_VIEW * half_fov)).any():
            return False
        planning.ignore(planning.grid.centers(cells))
        return True
