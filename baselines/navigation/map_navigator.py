"""Drives to goals on a known map: a layered costmap, A*, smoothing, a local planner, and recovery behaviors."""

import math
from dataclasses import replace
from itertools import product

import numpy as np

from baselines.navigation.params import DEFAULTS, MapNavigatorParams
from baselines.navigation.reactive_driving import ReactiveDriver
from envs.estimation import Belief
from envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from envs.navigation import (
    Costmap,
    CostmapParams,
    LayeredCostmap,
    Navigator,
    NavigatorParams,
    check_goal,
    is_path_valid,
    make_costmap,
    plan_path,
    smooth_path,
)
from envs.navigation.local_planner import make_local_planner
from envs.navigation.records import FAILED
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

STOP = Twist(0.0, 0.0)
"""Zero velocity."""
CLEARED_RADIUS = 1.5
"""Marks of scans this near to a robot that recovers are cleared [m]."""


class MapNavigator:
    """Drives a robot to one goal at a time, from readings and beliefs; never from ground truth.

    Obstacles around the robot, progress and recovery behaviors are those of `envs.navigation.Navigator`. Each recovery
    clears what scans have marked around the robot, and is followed by another plan. While the localizer reports that it
    is lost, the robot drives by the scan alone. Where no beam measures anything, it waits.
    """

    def __init__(
        self,
        robot: RobotParams,
        control_period: float,
        grid: OccupancyGrid,
        rng: np.random.Generator,
        params: MapNavigatorParams = DEFAULTS,
    ) -> None:
        """Prepare for a map.

        Args:
            robot: the robot.
            control_period: time between two calls of `act` [s].
            grid: the map; must not change afterwards.
            rng: source of the heading bias of reactive driving.
            params: how to drive.
        """
        self._robot, self._period, self._params = robot, control_period, params
        radius = robot.radius + params.padding
        self._costs = CostmapParams(radius, radius + params.inflation, params.cost_scaling_factor)
        self.layers = LayeredCostmap(grid, self._costs)
        """Obstacles: the map, and what scans have found since."""
        limits = NavigatorParams(
            goal_tolerance=0.0,  # judged here, with the heading
            stall_time=params.stall_time,
            stuck_distance=params.stuck_distance,
            stuck_time=params.stuck_time,
            max_recoveries=params.max_recoveries,
        )
        self._navigator = Navigator(robot, control_period, limits)
        self._planner = make_local_planner(params.local_planner, robot, control_period)
        self._reactive_driver = ReactiveDriver(robot, control_period, rng)
        self._time = -math.inf
        self._steps = self._lost_steps = self._blind_steps = 0
        self._was_localized = False
        self._forget_goal()

    def _forget_goal(self) -> None:
        self.goal: tuple[float, float] | None = None
        """Where to drive (x, y), map frame [m]."""
        self._heading: float | None = None
        self.end_reason: str | None = None
        """Why the drive there has ended: "reached", "no_path", "stuck", "lost" or "blind"; None while it has not."""
        self.num_recoveries = 0
        """Number of recovery behaviors since this goal was set."""
        self._has_path = self._has_planned = False
        self._counted = 0 if math.isinf(self._time) else self._navigator.num_recoveries
        self._share: float | None = None

    @property
    def is_driving(self) -> bool:
        """Whether there is a goal, and the drive there has not ended."""
        return self.goal is not None and self.end_reason is None

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._planner.remaining if self.is_driving and self._has_path else None

    def set_map(self, grid: OccupancyGrid) -> None:
        """Go on with another map in the same frame, which must not change; forget what scans marked."""
        self.layers = LayeredCostmap(grid, self._costs)

    def set_goal(self, goal: tuple[float, float], heading: float | None = None) -> None:
        """Drive to another goal (x, y), map frame [m], from now on, and take a heading [rad] there; None for any.

        Raises:
            ValueError: if the goal lies in an obstacle of the map, too near to one, in unknown space or off the map.
        """
        params = self._params
        if heading is not None and not math.isfinite(heading):
            raise ValueError(f"heading must be finite or None, got {heading}")
        # What scans have marked may go away; the map's walls do not.
        tightest = replace(self._costs, robot_radius=min((1.0, *params.tight_radii)) * self._robot.radius)
        costmap = make_costmap(self.layers.static, tightest)
        check_goal(costmap, goal, tolerance=params.goal_tolerance, allow_unknown=params.allow_unknown)
        self._forget_goal()
        self.goal, self._heading = goal, heading

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist for the next control period, and update `end_reason`.

        Raises:
            ValueError: if the reading is older than the one before.
        """
        twist = self._decide(reading, belief)
        self._navigator.note_command(twist)
        return twist

    def _decide(self, reading: Reading, belief: Belief) -> Twist:
        pose, navigator = belief.pose, self._navigator
        has_failed = self._sense(reading, pose)
        if self._is_blind(reading.ranges) or not self.is_driving:
            return STOP
        if reading.bumper and not self._has_path and not navigator.is_recovering:
            navigator.recover(backwards=navigator.is_forward)
        if has_failed or navigator.num_recoveries > self._counted:
            self._count_recovery(reading, pose)
        if not self.is_driving:
            return STOP
        if navigator.is_recovering:
            return navigator.command(pose)
        if self._is_lost(belief.is_lost):
            return self._reactive_driver.command(navigator.obstacles)
        if not self.is_driving:
            return STOP
        if self._is_due(self._params.update_period):
            self.layers.update(pose, reading.ranges, self._robot.lidar)
        return self._drive(pose)

    def _sense(self, reading: Reading, pose: Pose2D) -> bool:
        """Update the obstacles, and tell whether the robot has made no progress for too long."""
        if reading.time < self._time:
            raise ValueError(
                f"time went backwards: the reading is of {reading.time:.2f} s, the one before was of {self._time:.2f} "
                "s; make a new navigator for a new episode"
            )
        is_first, self._time = math.isinf(self._time), reading.time
        self._steps += 1
        if self._has_path and self.is_driving and not is_first:
            return self._navigator.update(reading, pose) == FAILED
        (self._navigator.reset if is_first else self._navigator.sense)(reading)
        return False

    def _is_due(self, period: float) -> bool:
        """Tell whether it is time for what is done once in a period [s]."""
        return self._steps % max(1, round(period / self._period)) == 0

    def _drive(self, pose: Pose2D) -> Twist:
        """Return the twist that follows the path; plans first where that is due."""
        navigator = self._navigator
        if self._is_at_goal(pose):
            self.end_reason = "reached"
            return STOP
        if self._has_path and self._is_due(self._params.check_period):
            self._has_path = self._is_path_good(pose)
        if not self._has_path and not self._find_path(pose):
            return STOP
        return self._planner.command(pose, Twist(navigator.v, navigator.w), navigator.obstacles)

    def _is_at_goal(self, pose: Pose2D) -> bool:
        assert self.goal is not None
        params = self._params
        if self._heading is not None and abs(wrap_angle(self._heading - pose.theta)) > params.heading_tolerance:
            return False
        # A path may end beside a goal that is not collision-free, and planners stop a little off its end.
        return math.hypot(pose.x - self.goal[0], pose.y - self.goal[1]) <= params.goal_tolerance

    def _is_path_good(self, pose: Pose2D) -> bool:
        path, params = self._planner.remaining, self._params
        away = float(np.hypot(*(path - pose[:2]).T).min())
        return away <= params.stray_distance and is_path_valid(self._costmap, path, allow_unknown=params.allow_unknown)

    def _find_path(self, pose: Pose2D) -> bool:
        """Plan; with less footprint, and then without the marks of scans, where there is no path.

        A goal that the map alone has no path to has failed; one that scans have closed the path to is tried again.
        """
        assert self.goal is not None
        params = self._params
        tolerance, allow_unknown = params.goal_tolerance, params.allow_unknown
        for forget, self._share in product((False, True), (None, *params.tight_radii)):
            if forget and self._share is None:
                self.layers.clear()
            costmap = self._costmap
            path = plan_path(costmap, pose[:2], self.goal, tolerance=tolerance, allow_unknown=allow_unknown)
            if path is not None:
                path = smooth_path(costmap, path, allow_unknown=allow_unknown)
                self._planner.set_path(path, self._heading)
                self._navigator.drive_to(path, keep_clocks=self._has_planned)
                if not self._has_planned:
                    self._counted = 0
                self._has_path = self._has_planned = True
                return True
        self.end_reason = "no_path"
        return False

    @property
    def _costmap(self) -> Costmap:
        """The costs now, for the padded robot or for a share of its radius where its plan needs that."""
        costmap = self.layers.costmap
        if self._share is None:
            return costmap
        return make_costmap(costmap.grid, replace(self._costs, robot_radius=self._share * self._robot.radius))

    def _count_recovery(self, reading: Reading, pose: Pose2D) -> None:
        """Clear the marks around a robot that recovers, and plan anew afterwards; too many times, and it is stuck."""
        navigator = self._navigator
        if navigator.num_recoveries == self._counted:
            navigator.recover()
        self._counted = navigator.num_recoveries
        self.num_recoveries += 1
        if self.num_recoveries > self._params.max_recoveries:
            self.end_reason = "stuck"
            return
        self.layers.clear_around(pose.x, pose.y, CLEARED_RADIUS)
        if reading.bumper:
            bearings = np.linspace(-0.5, 0.5, 5) + (0.0 if navigator.is_forward else math.pi)
            touched = (self._robot.radius + 0.05) * np.column_stack([np.cos(bearings), np.sin(bearings)])
            self.layers.mark(pose.transform(touched))
        self._has_path = False

    def _is_lost(self, is_lost: bool) -> bool:
        """Tell whether to drive reactively until the robot is localized; ends the drive after a while."""
        patience = self._params.lost_patience if self._was_localized else 0.0
        lost_for = self._lost_steps * self._period - patience
        if not is_lost:
            if lost_for > 0.0:
                self.layers.clear()
                self._has_path = False
            self._lost_steps, self._was_localized = 0, True
            return False
        self._lost_steps += 1
        if lost_for >= self._params.lost_time:
            self.end_reason = "lost"
        is_driving_reactively = lost_for >= 0.0 and self.is_driving
        self._has_path &= not is_driving_reactively
        return is_driving_reactively

    def _is_blind(self, ranges: np.ndarray) -> bool:
        """Tell whether no beam measured anything; ends the drive after a while."""
        self._blind_steps = self._blind_steps + 1 if np.isnan(ranges).all() else 0
        if self._blind_steps * self._period > self._params.blind_time and self.is_driving:
            self.end_reason = "blind"
        return self._blind_steps > 0
