"""Drives to goals on a known map: a layered costmap, A*, smoothing, a local planner, and ways out when stuck."""

import enum
import math
from dataclasses import dataclass, replace

import numpy as np

from baselines.local_planners import make_local_planner
from baselines.navigation.reactive_driving import ReactiveDriver
from baselines.obstacles import ObstacleMemory
from baselines.recovery import Dwell, Maneuvers
from envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from envs.navigation import (
    Costmap,
    CostmapParams,
    LayeredCostmap,
    check_goal,
    is_path_valid,
    make_costmap,
    plan_path,
    smooth_path,
)
from envs.robots import RobotParams
from envs.simulation import Twist
from envs.slam import Belief


@dataclass(frozen=True, slots=True)
class MapNavigatorParams:
    """How to drive to a goal."""

    local_planner: str = "rpp"
    """What follows paths; see `LOCAL_PLANNERS`."""
    padding: float = 0.03
    """Added to the robot's radius in plans [m]: half a map cell and the pose's jitter."""
    tight_radii: tuple[float, ...] = (1.0, 0.75)
    """Shares of the robot's radius that plans fall back on, in this order, where there is no way otherwise."""
    inflation: float = 0.45
    """How far beyond that nearness to obstacles costs [m]."""
    cost_scaling_factor: float = 4.0
    """Rate at which that cost decays with the distance [1/m]."""
    allow_unknown: bool = False
    """Whether paths may cross what neither map nor scans know."""
    goal_tolerance: float = 0.15
    """Distance at which a goal counts as reached [m]."""
    heading_tolerance: float = 0.15
    """Turn at which a goal's heading counts as reached [rad]."""
    update_period: float = 0.3
    """Time between two scans that are taken into the costmap [s]."""
    check_period: float = 1.0
    """Time between two looks at whether the path is still free [s]."""
    stray_distance: float = 0.5
    """Distance from the path at which another is planned [m]."""
    stall_time: float = 4.0
    """Time without moving or turning after which the robot tries to free itself [s]."""
    stuck_distance: float = 0.5
    """A robot that stays within this distance... [m]."""
    stuck_time: float = 20.0
    """...for this long tries to free itself too [s]."""
    max_recoveries: int = 6
    """Attempts to free itself after which the robot gives the goal up."""
    lost_patience: float = 5.0
    """Time that the robot drives on when the localiser says that it is lost, once it has been found [s]: along a bare
    wall doubts grow that go by themselves."""
    lost_time: float = 90.0
    """Time that it drives about by the scan alone after that, or at the start [s]."""
    blind_time: float = 5.0
    """Time that it waits for a scan in which anything was measured [s]."""


DEFAULTS = MapNavigatorParams()


class Progress(enum.Enum):
    """Where the robot stands with its goal."""

    IDLE = enum.auto()
    """There is none."""
    DRIVING = enum.auto()
    """It is on its way."""
    REACHED = enum.auto()
    """It believes to be there."""
    FAILED = enum.auto()
    """It has given up; `MapNavigator.end_reason` says why."""


class MapNavigator:
    """Drives a robot to one goal at a time, from what it observes and believes. Never sees the truth.

    When stuck it clears what scans have marked around it and, in turns, backs up and spins. When the localiser says
    that it is lost, it drives about by the scan alone until it is found. Where no beam measures anything, it waits.
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
            rng: decides which way to turn when nothing else does.
            params: how to drive.
        """
        self._robot = robot
        self._period = control_period
        self._params = params
        radius = robot.radius + params.padding
        self._costs = CostmapParams(radius, radius + params.inflation, params.cost_scaling_factor)
        self.layers = LayeredCostmap(grid, self._costs)
        """What is in the way: the map, and what scans have found since."""
        self._memory = ObstacleMemory(robot, control_period)
        self._planner = make_local_planner(params.local_planner, robot, control_period)
        self._maneuvers = Maneuvers(robot, control_period, rng)
        self._reactive_driver = ReactiveDriver(robot, control_period, rng)
        self._elapsed = 0.0
        self._steps = 0
        self._lost_steps = self._blind_steps = 0
        self._was_found = False
        self._forget_goal()

    def _forget_goal(self) -> None:
        self.goal: tuple[float, float] | None = None
        """Where the robot is going (x, y), map frame [m]."""
        self._heading: float | None = None
        self.progress = Progress.IDLE
        """Where it stands with that."""
        self.end_reason: str | None = None
        """Why it has stopped: "reached", "no_path", "stuck", "lost" or "blind"; None while it has not."""
        self.num_recoveries = 0
        """How often it had to free itself on the way to this goal."""
        self._has_path = False
        self._share: float | None = None
        self._stall = Dwell(0.25 * self._robot.radius + 0.02, 0.3)
        self._stuck = Dwell(self._params.stuck_distance)

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._planner.remaining if self.progress is Progress.DRIVING and self._has_path else None

    def set_goal(self, goal: tuple[float, float], heading: float | None = None) -> None:
        """Drive somewhere from now on.

        Args:
            goal: where to (x, y), map frame [m].
            heading: to stand in there [rad]; None for any.

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
        self.progress = Progress.DRIVING
        self._elapsed = 0.0

    def act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action, shape (2,), float32, that brings the robot nearer to its goal; updates `progress`.

        Args:
            observation: of `NavigateEnv`.
            belief: what the robot believes of its pose.

        Raises:
            ValueError: if the observation is older than the one before.
        """
        self._check_time(observation["motion"])
        scan, motion, pose = observation["scan"], observation["motion"], belief.pose
        obstacles = self._memory.update(scan, motion)
        self._steps += 1
        if self._is_blind(scan) or self.progress is not Progress.DRIVING:
            return self._action(Twist(0.0, 0.0))
        if motion[4] > 0.5 and not self._maneuvers:
            self._note_bump(pose, obstacles, backwards=motion[2] >= 0.0)
        if self._maneuvers:
            return self._action(self._maneuvers.next(obstacles))
        if self._is_lost(bool(observation["doubt"][2] > 0.5)):
            return self._action(self._reactive_driver.command(obstacles))
        if self.progress is not Progress.DRIVING:
            return self._action(Twist(0.0, 0.0))
        self._take_scan(pose, scan)
        return self._action(self._drive(pose, motion, obstacles))

    def _drive(self, pose: Pose2D, motion: np.ndarray, obstacles: np.ndarray) -> Twist:
        """Return the twist that follows the path, planning first where that is due."""
        params = self._params
        if self._is_there(pose):
            self._end(Progress.REACHED, "reached")
            return Twist(0.0, 0.0)
        due = self._steps % max(1, round(params.check_period / self._period)) == 0
        if (not self._has_path or (due and not self._is_path_good(pose))) and not self._find_path(pose):
            return Twist(0.0, 0.0)
        stalled = self._stall.update(pose) * self._period > params.stall_time
        stuck = self._stuck.update(pose) * self._period > params.stuck_time
        if stalled or stuck:
            self._recover(pose, obstacles)
            return self._maneuvers.next(obstacles) if self._maneuvers else Twist(0.0, 0.0)
        robot = self._robot
        return self._planner.command(pose, Twist(motion[0] * robot.max_v, motion[1] * robot.max_w), obstacles)

    def _is_there(self, pose: Pose2D) -> bool:
        assert self.goal is not None
        params = self._params
        if self._heading is not None and abs(wrap_angle(self._heading - pose.theta)) > params.heading_tolerance:
            return False
        # A path may end beside a goal that nobody can stand on, and planners stop a little off its end.
        return math.hypot(pose.x - self.goal[0], pose.y - self.goal[1]) <= params.goal_tolerance

    def _is_path_good(self, pose: Pose2D) -> bool:
        path = self._planner.remaining
        away = float(np.sqrt(((path - pose[:2]) ** 2).sum(axis=1).min()))
        costmap = self._costmap
        return away <= self._params.stray_distance and is_path_valid(
            costmap, path, allow_unknown=self._params.allow_unknown
        )

    def _find_path(self, pose: Pose2D) -> bool:
        """Plan; with the robot made smaller, and then with what scans have marked forgotten, where there is no way.

        A goal that the map alone has no way to has failed; one that scans have closed the way to is tried again.
        """
        for forget in (False, True):
            if forget:
                self.layers.clear()
            for share in (None, *self._params.tight_radii):
                self._share = share
                path = self._plan(pose)
                if path is not None:
                    self._planner.set_path(path, self._heading)
                    self._has_path = True
                    return True
        self._end(Progress.FAILED, "no_path")
        return False

    @property
    def _costmap(self) -> Costmap:
        """The costs now, for the padded robot or for a share of its radius where its plan needs that."""
        costmap = self.layers.costmap
        if self._share is None:
            return costmap
        radius = self._share * self._robot.radius
        return make_costmap(costmap.grid, replace(self._costs, robot_radius=radius))

    def _plan(self, pose: Pose2D) -> np.ndarray | None:
        assert self.goal is not None
        params, costmap = self._params, self._costmap
        tolerance, allow_unknown = params.goal_tolerance, params.allow_unknown
        path = plan_path(costmap, pose[:2], self.goal, tolerance=tolerance, allow_unknown=allow_unknown)
        return None if path is None else smooth_path(costmap, path, allow_unknown=allow_unknown)

    def _recover(self, pose: Pose2D, obstacles: np.ndarray) -> None:
        """Get free; after too many attempts the goal has failed."""
        self.num_recoveries += 1
        if self.num_recoveries > self._params.max_recoveries:
            self._end(Progress.FAILED, "stuck")
            return
        self.layers.clear_around(pose.x, pose.y, 1.5)
        if self.num_recoveries % 2:
            self._maneuvers.back_off(obstacles, backwards=True)
        else:
            self._maneuvers.spin(math.pi)
        self._start_over()

    def _start_over(self) -> None:
        """Plan anew, and count anew how long nothing happens."""
        self._has_path = False
        self._stall.restart()
        self._stuck.restart()

    def _note_bump(self, pose: Pose2D, obstacles: np.ndarray, *, backwards: bool) -> None:
        """Mark what the bumper touched, and leave it."""
        bearings = np.linspace(-0.5, 0.5, 5) + (0.0 if backwards else math.pi)
        touched = (self._robot.radius + 0.05) * np.column_stack([np.cos(bearings), np.sin(bearings)])
        self._recover(pose, obstacles)
        self._maneuvers.clear()
        if self.progress is Progress.DRIVING:
            self.layers.mark(pose.transform(touched))
            self._maneuvers.back_off(obstacles, backwards=backwards)

    def _is_lost(self, is_lost: bool) -> bool:
        """Tell whether to find out first where the robot is; gives up after a while."""
        patience = self._params.lost_patience if self._was_found else 0.0
        lost_for = self._lost_steps * self._period - patience
        if not is_lost:
            if lost_for > 0.0:
                self.layers.clear()
                self._start_over()
            self._lost_steps, self._was_found = 0, True
            return False
        self._lost_steps += 1
        if lost_for >= self._params.lost_time:
            self._end(Progress.FAILED, "lost")
        return lost_for >= 0.0 and self.progress is Progress.DRIVING

    def _is_blind(self, scan: np.ndarray) -> bool:
        """Tell whether no beam measured anything; gives up after a while."""
        self._blind_steps = 0 if scan.any() else self._blind_steps + 1
        if self._blind_steps * self._period > self._params.blind_time and self.progress is Progress.DRIVING:
            self._end(Progress.FAILED, "blind")
        return self._blind_steps > 0

    def _take_scan(self, pose: Pose2D, scan: np.ndarray) -> None:
        """Take a scan into the costmap now and then."""
        if self._steps % max(1, round(self._params.update_period / self._period)):
            return
        ranges = scan * self._robot.lidar.range_max
        ranges[scan >= 1.0] = np.inf
        ranges[scan <= 0.0] = np.nan
        self.layers.update(pose, ranges, self._robot.lidar)

    def _check_time(self, motion: np.ndarray) -> None:
        elapsed = float(motion[5])
        if elapsed < self._elapsed:
            raise ValueError(
                f"time went backwards: {elapsed:.4f} of the time limit has passed, and {self._elapsed:.4f} had before; "
                "make a new navigator for a new episode"
            )
        self._elapsed = elapsed

    def _end(self, progress: Progress, reason: str) -> None:
        self.progress, self.end_reason = progress, reason

    def _action(self, twist: Twist) -> np.ndarray:
        action = np.array([twist.v / self._robot.max_v, twist.w / self._robot.max_w], dtype=np.float32)
        return np.clip(action, -1.0, 1.0)
