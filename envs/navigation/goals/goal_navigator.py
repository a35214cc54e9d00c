"""Navigation to goals, on known maps or maps that grow during the drive."""

import dataclasses
import logging
import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product

import numpy as np
from pydantic import NonNegativeFloat, NonNegativeInt
from pydantic.dataclasses import dataclass

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.estimation.tracking import SENSITIVE_TRACKER, PeopleTracker
from lidarnaut.envs.files import resolve, with_defaults
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation.controllers.dwb import DwbPlanner
from lidarnaut.envs.navigation.controllers.local_planner import NO_TRACKS, LocalPlanner
from lidarnaut.envs.navigation.controllers.mppi import MppiPlanner
from lidarnaut.envs.navigation.controllers.navigator import Navigator
from lidarnaut.envs.navigation.controllers.navigator_kernels import FAILED
from lidarnaut.envs.navigation.controllers.reactive_driving import ReactiveDriver
from lidarnaut.envs.navigation.controllers.regulated_pursuit import FAST, PathFollower, turn_rate
from lidarnaut.envs.navigation.maps.costmap import COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN, Costmap
from lidarnaut.envs.navigation.maps.planning_map import PlanningMap
from lidarnaut.envs.navigation.maps.planning_params import DwbParams, NavigatorParams, PlanningParams
from lidarnaut.envs.navigation.policy import Explorer
from lidarnaut.envs.navigation.search.paths import exits, is_path_valid, plan_path, smooth_path
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

LOGGER = logging.getLogger(__name__)
STOP = Twist(0.0, 0.0)
CLEARED_RADIUS = 1.5
"""Recovery behaviors delete obstacles marked by scans from a square of this half side around the robot [m]."""
UNKNOWN_MARGIN, MAX_UNKNOWN_MARGIN = 3.0, 12.0
"""Initial and maximum width of unknown space around map, goal and robot that paths may cross [m]."""
MIN_EDGE_DISTANCE = 1.0
"""Distance of the robot from the map edge that triggers a map extension [m]."""
EXIT_REACH = 1.5
"""Maximum length of a straight path out of a mapped obstacle [m]."""
BLOCKED_REASONS = {
    COST_LETHAL: "in an obstacle of the map",
    COST_INSCRIBED: "too near to an obstacle of the map",
    COST_UNKNOWN: "in unknown space",
}
DETOUR_TIME = 10.0
"""After a failed drive, people count as obstacles in path planning for this time [s]."""
APPROACH_DISTANCE = 0.3
"""Distance to a goal with a heading below which pure pursuit replaces local planners that do not turn [m]."""
SEARCH_STEP, SEARCH_PATH = 0.4, 2.0
"""Search around the goal: distance between search points, and maximum path length to the next point [m]."""
HOME = (0.0, 0.0)
"""Start of the episode (x, y), map frame [m]."""
ON_KNOWN_MAPS = PlanningParams(cell=0.05, tight_radii=(1.0, 0.75))
"""Planning parameters for known maps: gaps at least as wide as 0.75 of the footprint."""
ON_GROWING_MAPS = PlanningParams(
    cell=0.05, padding=0.0, tight_radii=(0.9, 0.5, 0.25), marking_range=8.0, clearing_range=8.5
)
"""Planning parameters for growing maps: mark obstacles up to 8 m away, allow gaps as narrow as the footprint."""
NUM_FITTING = 2
"""Number of footprint radii, from the largest, tried first on growing maps. Smaller radii are a last resort."""
MakePlanner = Callable[[RobotParams, float, np.random.Generator], LocalPlanner]
"""Makes a local planner from robot, control period [s] and random generator."""


def local_planners(dwb: DwbParams = DwbParams()) -> dict[str, MakePlanner]:
    """Return the makers of the local planners by name; `dwb`: parameters of the planner of this name."""
    return {
        "rpp": lambda robot, period, _: PathFollower(robot, period),
        "rpp:fast": lambda robot, period, _: PathFollower(robot, period, FAST),
        "dwb": lambda robot, period, _: DwbPlanner(robot, period, dwb),
        "mppi": MppiPlanner,
    }


@dataclass(frozen=True, slots=True)
class GoalParams:
    """Parameters of drives to a goal."""

    local_planner: str = "rpp"
    """Local planner: `rpp` (pure pursuit), `rpp:fast`, `dwb`, `mppi`, or `module:attribute` of a custom planner."""
    track_people: bool = False
    """Track people in scans, for local planners that predict their motion."""
    allow_unknown: bool | None = None
    """Allow paths through unknown space; None: only on maps that grow during the drive."""
    goal_tolerance: NonNegativeFloat = 0.15
    """Distance to the goal that counts as arrival [m]."""
    search_radius: NonNegativeFloat = 0.0
    """Radius of the search around the goal if arrival does not end the task [m]; 0 for none."""
    heading_tolerance: NonNegativeFloat = 0.15
    """Heading tolerance at the goal [rad]."""
    update_period: NonNegativeFloat = 0.3
    """Time between scans integrated into the costmap [s]."""
    check_period: NonNegativeFloat = 0.3
    """Time between checks that the path is free [s]."""
    stray_distance: NonNegativeFloat = 0.5
    """Distance from the path that triggers replanning [m]."""
    max_recoveries: NonNegativeInt | None = 6
    """Maximum number of recovery behaviors per goal; None without limit."""
    max_searches: NonNegativeInt | None = 1
    """Number of failed path searches that ends the drive; None without limit. The robot looks around between
    searches."""
    lost_patience: NonNegativeFloat = 5.0
    """Time without localization before reactive driving by the scan [s]. Localization often recovers earlier."""
    lost_time: NonNegativeFloat = 90.0
    """Maximum time of reactive driving without localization [s]."""
    blind_time: NonNegativeFloat = 5.0
    """Maximum time without a valid lidar range [s]."""


@dataclasses.dataclass(slots=True)
class Attempt:
    """State of the drive to the present goal."""

    num_counted: int = 0
    """Recovery behaviors of the navigator that are counted."""
    search_points: list[tuple[float, float]] = dataclasses.field(default_factory=list)
    """Points (x, y) near the goal that are still to be searched, map frame [m]."""
    heading: float | None = None
    """Heading at the goal, map frame [rad]; None for any."""
    has_path: bool = False
    has_planned: bool = False
    is_turning: bool = False
    num_searches: int = 0
    """Failed path searches in succession."""
    level: int = 0
    """Index of the footprint radius that paths are searched with."""


@dataclasses.dataclass(slots=True)
class Clock:
    """Control periods since the reset, and in succession without localization or without a valid range."""

    steps: int = 0
    lost_steps: int = 0
    blind_steps: int = 0
    waited_until: float = -math.inf
    """Time at which the robot stops waiting [s]."""
    was_localized: bool = False


class GoalNavigator(Explorer):
    """Drives a robot to one goal at a time, along planned paths.

    Each recovery behavior deletes obstacles marked by scans and triggers replanning. Without localization, the robot
    drives reactively by the scan. Without valid ranges, the robot waits. On a growing map, paths may cross unknown
    space and are replanned when blocked.
    """

    def __init__(
        self, params: GoalParams = GoalParams(), planning: PlanningParams | None = None, dwb: DwbParams = DwbParams()
    ) -> None:
        """Create a navigator. `planning`: parameters; None for defaults that depend on whether the map is known."""
        self.params, self.planning = params, planning
        self.dwb = dwb if params.local_planner == "dwb" else None
        """Parameters of the local planner `dwb`; None for others."""
        self.goal: tuple[float, float] | None = None
        """Goal (x, y), map frame [m]."""
        self.target: tuple[float, float] | None = None
        """Current target (x, y), map frame [m]: goal or search point near the goal."""
        self.end_reason: str | None = None
        """Reason why the drive ended: "arrived" (by pose estimate), "no_path", "stuck", "lost" or "blind"; None while
        driving."""
        self._attempt = Attempt()

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._period = robot, control_period
        limits = NavigatorParams(goal_tolerance=0.0, max_recoveries=self.params.max_recoveries)
        self._navigator = Navigator(robot, control_period, limits)
        makers = local_planners(self.dwb or DwbParams())
        planner = resolve(self.params.local_planner, makers, "local planner")(robot, control_period, rng)
        self._planner: LocalPlanner = with_defaults(planner, LocalPlanner)
        tracks = self.params.track_people
        self._tracker = PeopleTracker(robot.lidar, control_period, SENSITIVE_TRACKER) if tracks else None
        self.tracks = NO_TRACKS
        self._reactive_driver = ReactiveDriver(robot, control_period, rng)
        self.map: PlanningMap | None = None
        """Map for path planning; None before the first `act`."""
        self._allow_unknown, self._margin = bool(self.params.allow_unknown), UNKNOWN_MARGIN
        self._time = -math.inf
        self._clock, self._takes_headings = Clock(), True
        self._tolerance, self._heading_tolerance = self.params.goal_tolerance, self.params.heading_tolerance
        self._forget_goal()

    def _forget_goal(self) -> None:
        self.goal = self.target = self.end_reason = None
        self.num_recoveries = 0
        self._attempt = Attempt(num_counted=int(self._navigator.record["recoveries"]))

    @property
    def is_driving(self) -> bool:
        return self.goal is not None and self.end_reason is None

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        """Remaining path, shape (n, 2), map frame [m]; None without a path."""
        return self._planner.remaining if self.is_driving and self._attempt.has_path else None

    def set_tolerances(self, distance: float, heading: float) -> None:
        """Set the goal tolerances of a task [m, rad] before `set_goal`.

        The robot aims for half of each tolerance, since its pose estimate is inaccurate. With a heading tolerance of
        pi, headings of goals are ignored, and the tolerances are those of the parameters.
        """
        self._takes_headings = heading < math.pi
        share = 0.5 if self._takes_headings else math.inf
        self._tolerance = min(self.params.goal_tolerance, share * distance)
        self._heading_tolerance = min(self.params.heading_tolerance, share * heading)

    def set_goal(self, goal: Sequence[float], heading: float | None = None) -> None:
        """Set a goal (x, y[, theta]), map frame [m, rad]; `heading` replaces theta. ValueError if not finite."""
        if heading is None and self._takes_headings and len(goal) > 2:
            heading = goal[2]
        if not all(map(math.isfinite, (*goal[:2], heading or 0.0))):
            raise ValueError(f"goal and heading must be finite, got {tuple(goal)} and {heading}")
        self._forget_goal()
        self.goal = self.target = float(goal[0]), float(goal[1])
        self._attempt.heading = heading
        step = SEARCH_STEP if heading is None else min(SEARCH_STEP, 2.0 * self._tolerance)
        for r in np.arange(step, self.params.search_radius + 1e-9, step):
            angles = np.arange(0.0, 2.0 * math.pi, step / r)
            points = np.column_stack([self.goal[0] + r * np.cos(angles), self.goal[1] + r * np.sin(angles)])
            self._attempt.search_points += map(tuple, points.tolist())
        if self.map is not None and self._allow_unknown:
            self.map.reach_beyond([self.goal], self._margin)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the next velocity command and update `end_reason`; ValueError if `reading` is older than the last."""
        twist = self._decide(reading, belief, self._follow_map(belief))
        self._navigator.note_command(twist)
        return twist

    def _follow_map(self, belief: Belief) -> PlanningMap:
        update = belief.update
        if self.map is None:
            if self.params.allow_unknown is None:
                self._allow_unknown = belief.grows
            planning = self.planning or (ON_GROWING_MAPS if self._allow_unknown else ON_KNOWN_MAPS)
            self.map = PlanningMap(self._robot, belief.grid.resolution, planning)
        if self._allow_unknown and self.goal is not None:
            (row, col), (height, width) = self.map.cell(*belief.pose[:2]), self.map.occupancy.shape
            edge = MIN_EDGE_DISTANCE / self.map.side
            if not (edge < row < height - edge and edge < col < width - edge):
                self.map.reach_beyond([self.goal, belief.pose[:2]], self._margin)
        self._attempt.has_path &= not update.redrawn
        self.map.update(belief.grid, update.window, redrawn=update.redrawn)
        return self.map

    def _decide(self, reading: Reading, belief: Belief, planning: PlanningMap) -> Twist:
        pose, navigator = belief.pose, self._navigator
        has_failed = self._sense(reading, pose)
        if self._tracker is not None:
            self.tracks = self._planner.tracks = self._tracker.update(reading.ranges, navigator.motion)
        self._clock.blind_steps = self._clock.blind_steps + 1 if np.isnan(reading.ranges).all() else 0
        if self._clock.blind_steps * self._period > self.params.blind_time and self.is_driving:
            self.end_reason = "blind"
        if self._clock.blind_steps > 0 or not self.is_driving:
            return STOP
        if reading.bumper and not self._attempt.has_path and not navigator.is_recovering:
            navigator.recover()
        if has_failed:
            self._clock.waited_until = reading.time + DETOUR_TIME
        if has_failed or navigator.record["recoveries"] > self._attempt.num_counted:
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
            ranges = reading.ranges
            if belief.on_people is not None and reading.time >= self._clock.waited_until:
                ranges = np.where(belief.on_people, np.float32(np.nan), ranges)
            planning.integrate(pose, ranges, self._robot.lidar)
        is_at_goal = self._is_at_goal(pose)
        turn = 0.0 if self._attempt.heading is None else wrap_angle(self._attempt.heading - pose.theta)
        is_turning, final_turn = abs(turn) > self._heading_tolerance, Twist(0.0, turn_rate(turn, navigator.numbers))
        if is_at_goal and is_turning:
            navigator.record["stuck_steps"] = -1  # not stuck; stalled turns still count
            if not self._planner.turns_at_goal:
                return final_turn
        elif is_at_goal and not self._next_search_point(pose, planning):
            self.end_reason = "arrived"
            return STOP
        if self._attempt.has_path and self._is_due(self.params.check_period):
            path = self._planner.remaining
            is_near = float(np.hypot(*(path - pose[:2]).T).min()) <= self.params.stray_distance
            costmap, allow_unknown = planning.costmap(self._attempt.level, pose), self._allow_unknown
            self._attempt.has_path = is_near and is_path_valid(costmap, path, allow_unknown=allow_unknown)
        if not self._attempt.has_path and not self._find_path(pose, planning):
            return navigator.command(pose) if self.is_driving else STOP
        if (
            self._attempt.heading is not None
            and not self._planner.turns_at_goal
            and self._distance(pose) <= APPROACH_DISTANCE
        ):
            navigator.follow(self._planner.remaining)
            return navigator.command(pose)
        twist: Twist = self._planner.command(pose, navigator.velocity, navigator.obstacles)
        # Sampled yaw rates are too coarse for the last degrees.
        return final_turn if is_at_goal and is_turning and twist.v == 0.0 else twist

    def _sense(self, reading: Reading, pose: Pose2D) -> bool:
        if reading.time < self._time:
            times = f"the reading is at {reading.time:.2f} s, the previous reading at {self._time:.2f} s"
            raise ValueError(f"time went backwards: {times}; call reset for a new episode")
        self._time = reading.time
        self._clock.steps += 1
        if self._attempt.has_path and self.is_driving:
            return self._navigator.update(reading, pose) == FAILED
        self._navigator.sense(reading)
        return False

    def _is_due(self, period: float) -> bool:
        return self._clock.steps % max(1, round(period / self._period)) == 0

    def _distance(self, pose: Pose2D) -> float:
        assert self.target is not None
        return math.dist(pose[:2], self.target)

    def _is_at_goal(self, pose: Pose2D) -> bool:
        # Planners stop slightly off a path's end. A turn may move the pose estimate.
        is_near = self._distance(pose) <= self._tolerance * (1.5 if self._attempt.is_turning else 1.0)
        self._attempt.is_turning = is_near and self._attempt.heading is not None
        return is_near

    def _next_search_point(self, pose: Pose2D, planning: PlanningMap) -> bool:
        costmap = planning.costmap(0, pose)
        while self._attempt.search_points:
            self.target = self._attempt.search_points.pop(0)
            path = plan_path(costmap, pose[:2], self.target)
            if path is not None and np.hypot(*np.diff(path, axis=0).T).sum() <= SEARCH_PATH:
                self._attempt.has_path = False
                return True
        return False

    def _find_path(self, pose: Pose2D, planning: PlanningMap) -> bool:
        assert self.goal is not None
        assert self.target is not None
        allow_unknown = self._allow_unknown
        levels = range(len(planning.tables))
        num_fitting = NUM_FITTING if allow_unknown else len(levels)
        attempts = *product((False, True), levels[:num_fitting]), *product((True,), levels[num_fitting:])
        for forget, self._attempt.level in attempts:
            if forget and allow_unknown and self._margin < MAX_UNKNOWN_MARGIN:
                self._margin *= 2.0
                planning.reach_beyond([self.goal, pose[:2]], self._margin)
                return False
            if forget and self._attempt.level == 0:
                planning.clear_marks()
            costmap = planning.costmap(self._attempt.level, pose)
            path = self._plan(pose, costmap, drive_out=forget)
            if path is not None:
                if self._attempt.heading is not None and math.dist(path[-1], self.target) < planning.side:
                    path[-1] = self.target
                path = smooth_path(costmap, path, allow_unknown=allow_unknown)
                ending = (self._attempt.heading, self._tolerance) if self._planner.turns_at_goal else ()
                self._planner.set_path(path, *ending)
                self._navigator.drive_to(path, keep_clocks=self._attempt.has_planned)
                if not self._attempt.has_planned:
                    self._attempt.num_counted = 0
                self._attempt.has_path = self._attempt.has_planned = True
                return True
        if not self._attempt.num_searches and not allow_unknown:
            LOGGER.warning("no path to the goal: %s", self._blocked(pose, costmap))
        self._attempt.num_searches += 1
        if self.params.max_searches is not None and self._attempt.num_searches >= self.params.max_searches:
            self.end_reason = "no_path"
        else:
            self._navigator.spin()
            self._attempt.num_counted = 0
        return False

    def _plan(self, pose: Pose2D, costmap: Costmap, *, drive_out: bool) -> np.ndarray | None:
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
        assert self.target is not None
        texts = []
        for name, point in (("start", pose[:2]), ("goal", self.target)):
            cell = costmap.grid.cells(np.array(point))
            where = BLOCKED_REASONS.get(costmap.costs[tuple(cell)]) if costmap.grid.contains(cell) else "off the map"
            texts += [f"{name} ({point[0]:.2f}, {point[1]:.2f}) is {where}"] if where else []
        return ", and ".join(texts) or "no gap between obstacles of the map is wide enough"

    def _count_recovery(self, reading: Reading, pose: Pose2D, planning: PlanningMap) -> None:
        navigator = self._navigator
        if navigator.record["recoveries"] == self._attempt.num_counted:
            navigator.recover()
        self._attempt.num_counted = int(navigator.record["recoveries"])
        self.num_recoveries += 1
        if self.params.max_recoveries is not None and self.num_recoveries > self.params.max_recoveries:
            self.end_reason = "stuck"
            return
        planning.clear_marks(pose[:2], CLEARED_RADIUS)
        if reading.bumper:
            bearings = np.linspace(-0.5, 0.5, 5) + (0.0 if navigator.record["forward"] else math.pi)
            touched = (self._robot.radius + 0.05) * np.column_stack([np.cos(bearings), np.sin(bearings)])
            planning.mark(pose.transform(touched))
        self._attempt.has_path = False

    def _is_lost(self, is_lost: bool, planning: PlanningMap) -> bool:
        patience = self.params.lost_patience if self._clock.was_localized else 0.0
        lost_for = self._clock.lost_steps * self._period - patience
        if not is_lost:
            if lost_for > 0.0:
                planning.clear_marks()
                self._attempt.has_path = False
            self._clock.lost_steps, self._clock.was_localized = 0, True
            return False
        self._clock.lost_steps += 1
        if lost_for >= self.params.lost_time:
            self.end_reason = "lost"
        is_driving_reactively = lost_for >= 0.0 and self.is_driving
        self._attempt.has_path &= not is_driving_reactively
        return is_driving_reactively


class HomeNavigator(GoalNavigator):
    """Drives a robot back to the origin of its map, through known space."""

    def __init__(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().__init__(GoalParams(allow_unknown=False, goal_tolerance=0.2, max_searches=3), PlanningParams())
        self.reset(robot, control_period, rng)
        self.set_goal(HOME)

    @property
    def home_reason(self) -> str | None:
        """Reason why the drive ended: `"arrived_home"` (by pose estimate) or `"no_path_home"`; None while driving."""
        return {None: None, "arrived": "arrived_home"}.get(self.end_reason, "no_path_home")
