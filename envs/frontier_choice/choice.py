"""One robot's choice between frontiers: what there is to choose from, the drive to what was chosen, what came of it."""

import math
from typing import Protocol

import numpy as np

from envs.frontier_choice.candidates import find_candidates
from envs.frontier_choice.features import FEATURES, describe
from envs.frontier_choice.nearby import frontier_in_sight, frontier_near
from envs.frontier_choice.params import PilotParams, SurveyParams
from envs.frontier_choice.pilot import look_around, sense, set_out
from envs.frontier_choice.records import ARRIVED, FAILED, GONE, LOOKED, PILOT, REPLAN, TIME_UP, PilotNumbers
from envs.frontier_choice.survey import plan_again, write_path
from envs.frontier_choice.tables import tables_of
from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation.astar import UNREACHED
from envs.navigation.obstacles import BUMP_POINTS, CAPACITY
from envs.navigation.paths import SHORTCUT
from envs.robots import RobotParams

MAX_POINTS = 1024
"""Points of a path; the rest of a longer one is left to the next plan."""
OVER, RESET = -1, -2
"""What a drive returns when the episode has ended; and in place of a drive's end after a reset."""
OUTCOMES = {
    ARRIVED: "arrived",
    GONE: "frontier_gone",
    FAILED: "failed",
    TIME_UP: "time_up",
    LOOKED: "looked_around",
    OVER: "episode_end",
    RESET: "reset",
}
"""How a drive ends, by what `judge` says; `OVER` and `RESET`."""


class Body(Protocol):
    """A robot that drives as its pilot says."""

    @property
    def grid(self) -> OccupancyGrid:
        """The map that it believes in."""
        ...

    @property
    def pose(self) -> Pose2D:
        """Where it believes to be, map frame."""
        ...

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        ...

    def drive(self) -> int:
        """Drive until `judge` says something, and return that, or `OVER` where the episode has ended."""
        ...


class FrontierChoice:
    """Offers frontiers, and has a drive carried out to the one that is chosen.

    It sees what the robot believes and senses, never the truth. Single environments and lanes use it alike: they give
    it a function that drives until `judge` says something.
    """

    def __init__(
        self,
        robot: RobotParams,
        period: float,
        resolution: float,
        directions: np.ndarray,
        *,
        max_candidates: int,
        max_time: float,
        survey: SurveyParams = SurveyParams(),
        pilot: PilotParams = PilotParams(),
    ) -> None:
        """Prepare for a robot.

        Args:
            robot: the robot.
            period: time between two control steps [s].
            resolution: side of a map cell [m].
            directions: shape (2, num_beams), float64: cosine and sine of the beams in the base frame.
            max_candidates: how many frontiers are offered at most.
            max_time: longest drive, but for a manoeuvre to get free, which is finished [s].
            survey: what is offered.
            pilot: how the drives go.
        """
        self._params = survey
        self._pilot_params = pilot
        self._resolution = resolution
        self._tables = tables_of(survey, robot, resolution)
        self.block = self._tables[0].block
        """Side of a planning cell [map cells]."""
        self._look_radius = min(pilot.look_radius * robot.radius, 0.75)
        self._max_candidates = max_candidates
        self.directions = directions
        self.numbers = PilotNumbers.of(robot, period, max_time, pilot)
        self.pilot = np.zeros(1, dtype=PILOT)
        """The record of type `PILOT`."""
        self.path = np.empty((MAX_POINTS, 2))
        """Shape (n, 2), float64, map frame [m]: the path; `num_points` of the record say how much of it counts."""
        self.obstacles = np.empty((CAPACITY + BUMP_POINTS + robot.lidar.num_beams, 2))
        """Shape (n, 2), float64, base frame [m], see `sense`."""
        self.features = np.zeros((max_candidates, len(FEATURES)), dtype=np.float32)
        """Shape (max_candidates, 10), float32: of the candidates, 0 in empty slots."""
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.pilot[:] = 0
        self.pilot["side"] = 1.0
        self.pilot["stall_steps"] = self.pilot["stuck_steps"] = -1
        self.pilot["forward"] = 1
        self.places = np.empty((0, 4))
        """Shape (k, 4), float64, map frame [m]: where to stand (x, y) and what to see from there, of each candidate."""
        self.features[:] = 0.0
        self.given_up = np.empty((0, 2))
        """Shape (m, 2), float64: frontier cells that do not count any more, nor do their neighbours, map frame [m]."""
        self._seen = np.empty((0, 3))
        self._failures = np.empty((0, 2))
        self._chosen = (math.inf, math.inf)
        self._planning = self._tables[0]
        self._still = (math.inf, math.inf, 0.0)
        self._now = 0.0

    @property
    def end_reason(self) -> str:
        """Why nothing is left to choose: `"no_reachable_frontier"`, or `"stuck"` if the robot could not move."""
        cannot_stand = bool((self._field[1] == UNREACHED).all())
        is_still = self._now - self._still[2] > self._pilot_params.still_time
        return "stuck" if cannot_stand or is_still else "no_reachable_frontier"

    @property
    def mask(self) -> np.ndarray:
        """Shape (max_candidates,), int8: 1 where there is a candidate."""
        mask = np.zeros(self._max_candidates, dtype=np.int8)
        mask[: len(self.places)] = 1
        return mask

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the path, shape (n, 2), map frame [m]; None without one."""
        first, last = self.pilot["index"][0], self.pilot["num_points"][0]
        return self.path[first:last] if self.pilot["has_goal"][0] else None

    def valid(self, action: int) -> int:
        """Return an action, or in place of one that has no candidate the last that has; -1 without any."""
        return min(action, len(self.places) - 1)

    def sense(self, ranges: np.ndarray, v: float, w: float, bumper: bool) -> None:
        """Take in a scan outside of drives; see `sense`."""
        sense(self.pilot[0], self.obstacles, ranges, self.directions, v, w, bumper, self.numbers)

    def survey(self, body: Body) -> None:
        """Find the candidates; the next tables, and shorter frontiers, only count where nothing else can be reached."""
        grid, pose = body.grid, body.pose
        self._now = body.time
        if math.dist(pose[:2], self._still[:2]) >= self._pilot_params.still_distance:
            self._still = (pose.x, pose.y, self._now)
        around = self.obstacles[: self.pilot["num_obstacles"][0]]
        where = (grid.data, grid.resolution, *grid.origin, *pose, around, self.given_up)
        side = self.block * grid.resolution
        lengths = tuple(max(1, round(length / side)) for length in self._params.min_lengths)
        for tables in self._tables:
            self._found, *self._field = find_candidates(*where, lengths, self._max_candidates, tables)
            if len(self._found):
                break
        self._planning = tables
        top, left = self._field[3:]
        scales = (math.pi * tables.gain_radius**2, float(tables.inflation), float(self._pilot_params.max_failures))
        self.places, self._seen = describe(
            self._found,
            top,
            left,
            *grid.origin,
            side,
            tuple(pose),
            self._now,
            self._seen,
            self._failures,
            self._chosen,
            self._pilot_params.retry_radius,
            scales,
            self.features,
        )

    def decide(self, action: int, body: Body) -> int:
        """Drive to a candidate, and find the next ones; where there is none, look around once before giving up.

        Args:
            action: a valid one.
            body: what drives.

        Returns:
            How the drive ended: one of `OUTCOMES`.
        """
        code = LOOKED
        if len(self.places):
            self._set_out(action, body.grid)
            code = self._finish(body)
            self.survey(body)
        if not len(self.places) and code != OVER:
            look_around(self.pilot[0], self.numbers)
            looked = body.drive()
            code = OVER if looked == OVER else code
            self.survey(body)
        return code

    def _finish(self, body: Body) -> int:
        """Drive until there is something to learn from it, and return that."""
        grid = body.grid
        code = body.drive()
        while code == REPLAN and self._replan(body):
            code = body.drive()
        if code == REPLAN:
            code = FAILED
        if code == FAILED:
            self._fail(grid)
        elif code == ARRIVED:
            self._give_up_in_sight(grid, body.pose)
        return code

    def _set_out(self, action: int, grid: OccupancyGrid) -> None:
        tables = self._planning
        side = self.block * grid.resolution
        costs, travel, came_by, top, left = self._field
        row, col = self._found[action, :2].astype(np.int64)
        corner = grid.origin[0] + left * side, grid.origin[1] + top * side
        reach = max(2, round(SHORTCUT / side))
        num_points = write_path(costs, travel, came_by, row, col, tables.weights, reach, *corner, side, self.path)
        set_out(self.pilot[0], num_points, *self.places[action])
        self._chosen = tuple(self.places[action, 2:].tolist())

    def _replan(self, body: Body) -> bool:
        """Plan the way to the goal anew; False if there is none any more."""
        grid, tables, goal = body.grid, self._planning, self.pilot[0]
        reach = max(2, round(SHORTCUT / (self.block * grid.resolution)))
        around = self.obstacles[: goal["num_obstacles"]]
        where = (grid.data, grid.resolution, *grid.origin, *body.pose, around, goal["goal_x"], goal["goal_y"])
        num_points = plan_again(*where, self.numbers.goal_tolerance, reach, tables, self.path)
        goal["num_points"], goal["index"] = num_points, 0
        return num_points > 0

    def _fail(self, grid: OccupancyGrid) -> None:
        """Take note that the robot did not get to where it should look at a frontier."""
        x, y = self.pilot["frontier_x"][0], self.pilot["frontier_y"][0]
        self._failures = np.vstack([self._failures, (x, y)])
        near = np.hypot(*(self._failures - (x, y)).T) <= self._pilot_params.retry_radius
        if np.count_nonzero(near) >= self._pilot_params.max_failures:
            self._give_up(self._frontier_near(grid, self._look_radius))

    def _give_up_in_sight(self, grid: OccupancyGrid, pose: Pose2D) -> None:
        """Give up what has not come to light though the robot stands where it wanted to see it from."""
        if len(self._frontier_near(grid, self._pilot_params.frontier_radius)) == 0:
            return
        goal, numbers = self.pilot[0], self.numbers
        frontier = goal["frontier_x"], goal["frontier_y"]
        gap = math.dist(frontier, pose[:2])
        view = pose.theta + numbers.mount[2], math.pi if numbers.sees_around else numbers.half_fov
        frame = (grid.data, *grid.origin, grid.resolution, self.block)
        in_sight = frontier_in_sight(*frame, pose.x, pose.y, *view, gap + self._look_radius, self.given_up)
        # What the visit was for goes in any case, or the robot would come back for ever.
        radius = self._pilot_params.frontier_radius
        beside = frontier_in_sight(*frame, *frontier, 0.0, math.pi, radius, self.given_up)
        self._give_up(np.vstack([in_sight, frontier, beside]))

    def _frontier_near(self, grid: OccupancyGrid, radius: float) -> np.ndarray:
        """Return the frontier cells within `radius` [m] of the chosen one, shape (k, 2), map frame [m]."""
        frame = (grid.data, *grid.origin, grid.resolution, self.block)
        place = self.pilot["frontier_x"][0], self.pilot["frontier_y"][0]
        return frontier_near(*frame, *place, radius, self.given_up)

    def _give_up(self, cells: np.ndarray) -> None:
        """Leave frontier cells, shape (k, 2), map frame [m], out from now on."""
        self.given_up = np.vstack([self.given_up, cells])
