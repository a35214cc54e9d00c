"""Drives to goals, on a known map or on one that grows: costmap, A*, smoothing, a local planner, recovery behaviors."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Protocol

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.estimation.tracking import PeopleTracker, TrackerParams
from lidarnaut.envs.files import resolve
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation.costmap import COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN, Costmap
from lidarnaut.envs.navigation.dwb import DwbPlanner
from lidarnaut.envs.navigation.mppi import MppiPlanner
from lidarnaut.envs.navigation.navigator import Navigator
from lidarnaut.envs.navigation.navigator_kernels import FAILED
from lidarnaut.envs.navigation.params import NavigatorParams, PlanningParams
from lidarnaut.envs.navigation.paths import exits, is_path_valid, plan_path, smooth_path
from lidarnaut.envs.navigation.planning_map import PlanningMap
from lidarnaut.envs.navigation.pursuit import FAST, PathFollower, turn_rate
from lidarnaut.envs.navigation.reactive_driving import ReactiveDriver
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

LOGGER = logging.getLogger(__name__)
STOP = Twist(0.0, 0.0)
"""Zero velocity."""
CLEARED_RADIUS = 1.5
"""Marks of scans this near to a robot that recovers are cleared [m]."""
MARGIN, MAX_MARGIN = 3.0, 12.0
"""Unknown space around a map that grows, and around goal and robot beyond it, through which paths may lead [m]: at
first, and at most, since it is doubled where there is no path."""
EDGE = 1.0
"""Planning cells reach at least this far beyond the robot [m]."""
EAGER = TrackerParams(
    min_travel=0.25,
    hidden_travel=0.4,
    position_std=0.04,
    acceleration=1.5,
    memory=6.0,
    stood_hits=3,
    static_hits=4,
    body_radius=0.3,
)
"""Tracks for driving: somebody who is noticed late costs more than a chair that is taken for somebody."""
NO_TRACKS = np.empty((0, 5))
"""Nobody is tracked."""
EXIT_REACH = 1.5
"""Longest straight path out of an obstacle of the map [m]."""
BLOCKED = {
    COST_LETHAL: "in an obstacle of the map",
    COST_INSCRIBED: "too near to an obstacle of the map",
    COST_UNKNOWN: "in unknown space",
}
"""Reasons to have no path from a cell or to it, by its cost."""
DETOUR_TIME = 10.0
"""Time for which people block paths once the robot has got nowhere among them [s]."""
APPROACH = 0.3
"""Distance to a goal with a heading below which pure pursuit replaces the local planner [m]: DWB stops short of goals
beside walls."""
SEARCH_STEP, SEARCH_PATH = 0.4, 2.0
"""Distance between points around a goal, and greatest length of the path from one to the next [m]."""
HOME = (0.0, 0.0)
"""Where the map begins (x, y), map frame [m]."""


ON_KNOWN_MAPS = PlanningParams(cell=0.05, tight_radii=(1.0, 0.75))
"""How paths are planned where a map is given..."""
ON_GROWING_MAPS = PlanningParams(
    cell=0.05, padding=0.0, tight_radii=(0.9, 0.5, 0.25), marking_range=8.0, clearing_range=8.5
)
"""...and where there is none, or not all of it: scans mark from afar, and robots need no detour where they fit."""
NUM_FITTING = 2
"""On maps that grow, so many footprint padding levels are those of gaps that the robot fits through. The others lead it
to where the map may be wrong: who stood in a door is in the map until a scan looks there again."""


class LocalPlanner(Protocol):
    """Follows one path at a time. Constructed with the robot, the control period [s] and a random generator.

    Obstacles come in the robot's own frame and not out of a map, so that stops do not depend on the pose estimate. One
    that has an attribute `tracks` finds people there where the navigator tracks them; see `PeopleTracker.people`.
    """

    @property
    def blocked(self) -> bool:
        """Whether the last command did not drive on because of obstacles."""

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""

    def set_path(self, path: np.ndarray) -> None:
        """Follow another path: shape (n, 2), n > 0, map frame [m]."""

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the next twist, by the estimated pose (map frame), the velocity now, and `Navigator.obstacles`."""


MakePlanner = Callable[[RobotParams, float, np.random.Generator], LocalPlanner]
LOCAL_PLANNERS: dict[str, MakePlanner] = {
    "rpp": lambda robot, period, _: PathFollower(robot, period),
    "rpp:fast": lambda robot, period, _: PathFollower(robot, period, FAST),
    "dwb": lambda robot, period, _: DwbPlanner(robot, period),
    "mppi": MppiPlanner,
}
"""Regulated pure pursuit, the same with numbers for fast robots, DWB and MPPI."""


@dataclass(frozen=True, slots=True)
class GoalParams:
    """How to drive to a goal."""

    local_planner: str = "rpp"
    """What follows paths: `rpp`, `rpp:fast`, `dwb`, `mppi`, or `module:attribute` of a `LocalPlanner`."""
    track_people: bool = False
    """Whether people are tracked in the scans, for planners that predict where they will be."""
    allow_unknown: bool | None = None
    """Whether paths may cross what neither map nor scans know; None: on maps that grow."""
    goal_tolerance: float = 0.15
    """Distance at which a goal counts as reached [m]."""
    search_radius: float = 0.0
    """Distance from the goal up to which the robot drives on around it, where a task does not end with its arrival [m]:
    its pose estimate is off. At 0 it stops there."""
    heading_tolerance: float = 0.15
    """Greatest turn from a goal's heading that counts as reached [rad]. See also `GoalNavigator.set_tolerances`."""
    update_period: float = 0.3
    """Time between two scans that are integrated into the costmap [s]."""
    check_period: float = 0.3
    """Time between two checks whether the path is still free [s]."""
    stray_distance: float = 0.5
    """Distance from the path at which another is planned [m]."""
    max_recoveries: int = 6
    """Recovery behaviors after which the goal has failed."""
    max_searches: int = 1
    """Searches without a path after which the goal has failed; the robot looks around in between."""
    lost_patience: float = 5.0
    """Time that the robot drives on when the localizer reports that it is lost, once it was localized [s]: along a bare
    wall the pose uncertainty grows and shrinks again."""
    lost_time: float = 90.0
    """Time of reactive driving after that, or at the start [s]."""
    blind_time: float = 5.0
    """Time that it waits for a scan in which anything was measured [s]."""


class GoalNavigator:
    """Drives a robot to one goal at a time, from readings and beliefs, never from ground truth. An `Explorer`.

    Obstacles around the robot, progress and recovery behaviors are those of `Navigator`. Each recovery clears what
    scans have marked around the robot, and is followed by another plan. While the estimator reports that it is lost,
    the robot drives by the scan alone. Where no beam measures anything, it waits. On a map that grows, paths may cross
    unknown space, and another one is planned when what comes into view blocks it.
    """

    def __init__(
        self,
        params: GoalParams = GoalParams(),
        planning: PlanningParams | None = None,
    ) -> None:
        """Take parameters: how to drive, and how paths are planned (None: `ON_KNOWN_MAPS` or `ON_GROWING_MAPS`).

        `reset` prepares for an episode.
        """
        self.params, self.planning = params, planning
        self.goal: tuple[float, float] | None = None
        """Where to drive (x, y), map frame [m]."""
        self.target: tuple[float, float] | None = None
        """The goal, or the point around it to which the robot drives now."""
        self.end_reason: str | None = None
        """Why the drive there has ended: "arrived", by the estimate, "no_path", "stuck", "lost" or "blind"; None while
        it has not."""
        self._has_path = False

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._period = robot, control_period
        # Whether the goal is reached is judged here, with the heading.
        limits = NavigatorParams(goal_tolerance=0.0, max_recoveries=self.params.max_recoveries)
        self._navigator = Navigator(robot, control_period, limits)
        make_planner = resolve(self.params.local_planner, LOCAL_PLANNERS, "local planner")
        self._planner = make_planner(robot, control_period, rng)
        self._tracker = PeopleTracker(robot.lidar, control_period, EAGER) if self.params.track_people else None
        self.tracks = NO_TRACKS
        """People that are tracked; see `PeopleTracker.people`."""
        self._waited_until = -math.inf
        self._reactive_driver = ReactiveDriver(robot, control_period, rng)
        self.map: PlanningMap | None = None
        """The costmap; None before the first `act`."""
        self._allow_unknown, self._margin = bool(self.params.allow_unknown), MARGIN
        self._time = -math.inf
        self._steps = self._lost_steps = self._blind_steps = 0
        self._was_localized = self._takes_headings = False
        self._tolerance, self._heading_tolerance = self.params.goal_tolerance, self.params.heading_tolerance
        self._forget_goal()

    def _forget_goal(self) -> None:
        self.goal = self.target = self.end_reason = None
        self._around: list[tuple[float, float]] = []
        self.num_recoveries = 0
        """Number of recovery behaviors since this goal was set."""
        self._heading: float | None = None
        self._has_path = self._has_planned = self._is_turning = False
        self._num_counted = int(self._navigator.record["recoveries"])
        self._num_searches = self._level = 0

    @property
    def is_driving(self) -> bool:
        """Whether there is a goal, and the drive there has not ended."""
        return self.goal is not None and self.end_reason is None

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._planner.remaining if self.is_driving and self._has_path else None

    def set_tolerances(self, distance: float, heading: float) -> None:
        """Take the tolerances of a task [m, rad]; to be called before `set_goal`, whose goals are poses from then on.

        The robot comes to within half of each, because its pose estimate is off. A heading tolerance of pi asks for no
        heading, and changes nothing.
        """
        if heading < math.pi:
            self._takes_headings = True
            self._tolerance = min(self.params.goal_tolerance, 0.5 * distance)
            self._heading_tolerance = min(self.params.heading_tolerance, 0.5 * heading)

    def set_goal(self, goal: Sequence[float], heading: float | None = None) -> None:
        """Drive to another goal (x, y, ...), map frame [m], from now on, and take a heading [rad] there; None for any.

        Raises:
            ValueError: if one is not finite.
        """
        if heading is None and self._takes_headings and len(goal) > 2:
            heading = goal[2]
        if not all(map(math.isfinite, (*goal[:2], heading or 0.0))):
            raise ValueError(f"goal and heading must be finite, got {tuple(goal)} and {heading}")
        self._forget_goal()
        self.goal = self.target = float(goal[0]), float(goal[1])
        self._heading = heading
        step = SEARCH_STEP if heading is None else min(SEARCH_STEP, 2.0 * self._tolerance)
        for r in np.arange(step, self.params.search_radius + 1e-9, step):
            angles = np.arange(0.0, 2.0 * math.pi, step / r)
            points = np.column_stack([self.goal[0] + r * np.cos(angles), self.goal[1] + r * np.sin(angles)])
            self._around += map(tuple, points.tolist())
        if self.map is not None and self._allow_unknown:
            self.map.reach_beyond([self.goal], self._margin)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist for the next control period, and update `end_reason`; see `Explorer`.

        Raises:
            ValueError: if the reading is older than the one before.
        """
        planning = self._follow_map(belief)
        twist = self._decide(reading, belief, planning)
        self._navigator.note_command(twist)
        return twist

    def _follow_map(self, belief: Belief) -> PlanningMap:
        """Take note of what the last scan has changed in the map."""
        update = belief.update
        if self.map is None:
            if self.params.allow_unknown is None:
                self._allow_unknown = update.window is not None or update.redrawn
            planning = self.planning or (ON_GROWING_MAPS if self._allow_unknown else ON_KNOWN_MAPS)
            self.map = PlanningMap(self._robot, belief.grid.resolution, planning)
        if self._allow_unknown and self.goal is not None and not self._is_inside(belief.pose):
            self.map.reach_beyond([self.goal, belief.pose[:2]], self._margin)
        self._has_path &= not update.redrawn
        self.map.update(belief.grid, update.window, redrawn=update.redrawn)
        return self.map

    def _is_inside(self, pose: Pose2D) -> bool:
        """Tell whether planning cells reach beyond a pose."""
        assert self.map is not None
        (row, col), (height, width) = self.map.cell(*pose[:2]), self.map.joined.shape
        edge = EDGE / self.map.side
        return bool(edge < row < height - edge and edge < col < width - edge)

    def _decide(self, reading: Reading, belief: Belief, planning: PlanningMap) -> Twist:
        pose, navigator = belief.pose, self._navigator
        has_failed = self._sense(reading, pose)
        self._track(reading.ranges)
        if self._is_blind(reading.ranges) or not self.is_driving:
            return STOP
        if reading.bumper and not self._has_path and not navigator.is_recovering:
            navigator.recover()
        if has_failed:
            self._waited_until = reading.time + DETOUR_TIME
        if has_failed or navigator.record["recoveries"] > self._num_counted:
            self._count_recovery(reading, pose, planning)
        if not self.is_driving:
            return STOP
        if navigator.is_recovering:
            return navigator.command(pose)
        if self._is_lost(belief.is_lost, planning):
            return self._reactive_driver.command(navigator.obstacles)
        if not self.is_driving:
            return STOP
        if self._is_due(self.params.update_period):
            planning.integrate(pose, self._without_people(reading, belief), self._robot.lidar)
        is_at_goal = self._is_at_goal(pose)
        turn = 0.0 if self._heading is None else wrap_angle(self._heading - pose.theta)
        if is_at_goal and abs(turn) > self._heading_tolerance:
            navigator.record["stuck_steps"] = -1  # it turns on the spot, and a turn that stalls still counts
            return Twist(0.0, turn_rate(turn, navigator.numbers))
        if is_at_goal and not self._drive_on_around(pose, planning):
            self.end_reason = "arrived"
            return STOP
        if self._has_path and self._is_due(self.params.check_period):
            path = self._planner.remaining
            is_near = float(np.hypot(*(path - pose[:2]).T).min()) <= self.params.stray_distance
            costmap, allow_unknown = planning.costmap(self._level, pose), self._allow_unknown
            self._has_path = is_near and is_path_valid(costmap, path, allow_unknown=allow_unknown)
        if not self._has_path and not self._find_path(pose, planning):
            return navigator.command(pose) if self.is_driving else STOP
        if self._heading is not None and self._distance(pose) <= APPROACH:
            navigator.follow(self._planner.remaining)
            return navigator.command(pose)
        return self._planner.command(pose, navigator.velocity, navigator.obstacles)

    def _sense(self, reading: Reading, pose: Pose2D) -> bool:
        """Update the obstacles, and tell whether the robot has made no progress for too long."""
        if reading.time < self._time:
            raise ValueError(
                f"time went backwards: the reading is of {reading.time:.2f} s, the one before was of {self._time:.2f} "
                "s; call reset for a new episode"
            )
        is_first, self._time = math.isinf(self._time), reading.time
        self._steps += 1
        if self._has_path and self.is_driving and not is_first:
            return self._navigator.update(reading, pose) == FAILED
        (self._navigator.reset if is_first else self._navigator.sense)(reading)
        return False

    def _without_people(self, reading: Reading, belief: Belief) -> np.ndarray:
        """Return the scan for the costmap: without people, who will have walked on before the robot gets to them.

        A path around a doorway that somebody walks through may lead through all of the unknown world. Where the robot
        has got nowhere, people block paths like anything else for a while.
        """
        if belief.on_people is None or reading.time < self._waited_until:
            return reading.ranges
        return np.where(belief.on_people, np.float32(np.nan), reading.ranges)

    def _track(self, ranges: np.ndarray) -> None:
        """Track people, for a planner that asks for them."""
        if self._tracker is not None:
            self.tracks = self._tracker.update(ranges, self._navigator.motion)
            if hasattr(self._planner, "tracks"):
                self._planner.tracks = self.tracks

    def _is_due(self, period: float) -> bool:
        """Tell whether it is time for what is done once in a period [s]."""
        return self._steps % max(1, round(period / self._period)) == 0

    def _distance(self, pose: Pose2D) -> float:
        """Return the straight distance to the target [m]."""
        assert self.target is not None
        return math.dist(pose[:2], self.target)

    def _is_at_goal(self, pose: Pose2D) -> bool:
        # A path may end beside a goal that is not collision-free, and planners stop a little off its end. While the
        # robot turns there, its pose estimate may move.
        is_near = self._distance(pose) <= self._tolerance * (1.5 if self._is_turning else 1.0)
        self._is_turning = is_near and self._heading is not None
        return is_near

    def _drive_on_around(self, pose: Pose2D, planning: PlanningMap) -> bool:
        """Set out for the next point around the goal to which there is a short path; false if none is left."""
        costmap = planning.costmap(0, pose)
        while self._around:
            self.target = self._around.pop(0)
            path = plan_path(costmap, pose[:2], self.target)
            if path is not None and np.hypot(*np.diff(path, axis=0).T).sum() <= SEARCH_PATH:
                self._has_path = False
                return True
        return False

    def _find_path(self, pose: Pose2D, planning: PlanningMap) -> bool:
        """Plan; where there is no path, with less footprint, then farther around, then without the marks of scans.

        Then also out of an obstacle of the map that the scan does not show. In the end, on a map that grows, also
        through gaps that the robot does not fit through.
        """
        assert self.goal is not None
        assert self.target is not None
        allow_unknown = self._allow_unknown
        levels = range(planning.max_level + 1)
        num_fitting = NUM_FITTING if allow_unknown else len(levels)
        attempts = *product((False, True), levels[:num_fitting]), *product((True,), levels[num_fitting:])
        for forget, self._level in attempts:
            if forget and allow_unknown and self._margin < MAX_MARGIN:
                self._margin *= 2.0
                planning.reach_beyond([self.goal, pose[:2]], self._margin)
                return False
            if forget and self._level == 0:
                planning.clear_marks()
            costmap = planning.costmap(self._level, pose)
            path = self._plan(pose, costmap, drive_out=forget)
            if path is not None:
                if self._heading is not None and math.dist(path[-1], self.target) < planning.side:
                    path[-1] = self.target  # and not the middle of its cell
                path = smooth_path(costmap, path, allow_unknown=allow_unknown)
                self._planner.set_path(path)
                self._navigator.drive_to(path, keep_clocks=self._has_planned)
                if not self._has_planned:
                    self._num_counted = 0
                self._has_path = self._has_planned = True
                return True
        if not self._num_searches and not allow_unknown:
            LOGGER.warning("no path to the goal: %s", self._blocked(pose, costmap))
        self._num_searches += 1
        if self._num_searches >= self.params.max_searches:
            self.end_reason = "no_path"
        else:
            self._navigator.spin()  # another look may show that what blocks the path has moved
            self._num_counted = 0
        return False

    def _plan(self, pose: Pose2D, costmap: Costmap, *, drive_out: bool) -> np.ndarray | None:
        """Return a path; if asked to, also one out of an obstacle of the map that the scan does not show."""
        assert self.target is not None
        unknown = self._allow_unknown
        search = partial(plan_path, costmap, goal=self.target, tolerance=self._tolerance, allow_unknown=unknown)
        path = search(pose[:2])
        if path is None and drive_out:
            for out in exits(costmap, pose, self._navigator.obstacles, EXIT_REACH):
                path = search((out[-1, 0], out[-1, 1]))
                if path is not None:
                    return np.vstack([out, path])
        return path

    def _blocked(self, pose: Pose2D, costmap: Costmap) -> str:
        """Explain a missing path by the cells of start and goal."""
        assert self.target is not None
        texts = []
        for name, point in (("start", pose[:2]), ("goal", self.target)):
            cell = costmap.grid.cells(np.array(point))
            where = BLOCKED.get(costmap.costs[tuple(cell)]) if costmap.grid.contains(cell) else "off the map"
            texts += [f"{name} ({point[0]:.2f}, {point[1]:.2f}) is {where}"] if where else []
        return ", and ".join(texts) or "no gap between obstacles of the map is wide enough"

    def _count_recovery(self, reading: Reading, pose: Pose2D, planning: PlanningMap) -> None:
        """Clear the marks around a robot that recovers, and plan anew afterwards; too many times, and it is stuck."""
        navigator = self._navigator
        if navigator.record["recoveries"] == self._num_counted:
            navigator.recover()
        self._num_counted = int(navigator.record["recoveries"])
        self.num_recoveries += 1
        if self.num_recoveries > self.params.max_recoveries:
            self.end_reason = "stuck"
            return
        planning.clear_marks(pose[:2], CLEARED_RADIUS)
        if reading.bumper:
            bearings = np.linspace(-0.5, 0.5, 5) + (0.0 if navigator.record["forward"] else math.pi)
            touched = (self._robot.radius + 0.05) * np.column_stack([np.cos(bearings), np.sin(bearings)])
            planning.mark(pose.transform(touched))
        self._has_path = False

    def _is_lost(self, is_lost: bool, planning: PlanningMap) -> bool:
        """Tell whether to drive reactively until the robot is localized; ends the drive after a while."""
        patience = self.params.lost_patience if self._was_localized else 0.0
        lost_for = self._lost_steps * self._period - patience
        if not is_lost:
            if lost_for > 0.0:
                planning.clear_marks()
                self._has_path = False
            self._lost_steps, self._was_localized = 0, True
            return False
        self._lost_steps += 1
        if lost_for >= self.params.lost_time:
            self.end_reason = "lost"
        is_driving_reactively = lost_for >= 0.0 and self.is_driving
        self._has_path &= not is_driving_reactively
        return is_driving_reactively

    def _is_blind(self, ranges: np.ndarray) -> bool:
        """Tell whether no beam measured anything; ends the drive after a while."""
        self._blind_steps = self._blind_steps + 1 if np.isnan(ranges).all() else 0
        if self._blind_steps * self._period > self.params.blind_time and self.is_driving:
            self.end_reason = "blind"
        return self._blind_steps > 0


class HomeNavigator(GoalNavigator):
    """Drives a robot back to where its map begins, through what the map knows, once exploration is over."""

    def __init__(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a robot; `rng` is asked where it is lost."""
        super().__init__(GoalParams(allow_unknown=False, goal_tolerance=0.2, max_searches=3), PlanningParams())
        self.reset(robot, control_period, rng)
        self.set_goal(HOME)

    @property
    def home_reason(self) -> str | None:
        """Why the drive has ended: `"arrived_home"`, by the estimate, or `"no_path_home"`; None while it has not."""
        reasons = {None: None, "arrived": "arrived_home"}
        return reasons.get(self.end_reason, "no_path_home")
