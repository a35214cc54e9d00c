"""Drives to goals over the belief: a costmap, A*, the path follower, and ways out when stuck."""

import enum
import math
from dataclasses import dataclass

import numpy as np

from baselines.obstacles import ObstacleMemory
from baselines.path_follower import PathFollower
from baselines.recovery import Dwell, Maneuvers
from baselines.survey import Survey
from envs.geometry import Pose2D, wrap_angle
from envs.navigation import CostmapParams, plan_path
from envs.robots import RobotParams
from envs.simulation import Twist
from envs.slam import Belief

NO_POINTS = np.empty((0, 2))
"""No obstacles."""


@dataclass(frozen=True, slots=True)
class NavigatorParams:
    """How to drive to a goal."""

    padding: float = 0.03
    """Added to the robot's radius in plans [m]: half a map cell and the pose's jitter."""
    tight_radii: tuple[float, ...] = (1.0, 0.75, 0.5)
    """Shares of the robot's radius that plans fall back on, in this order, when nothing can be reached otherwise: walls
    of a map that has drifted close gaps that are open in truth, and the scan guards the real robot anyway."""
    inflation: float = 0.45
    """How far beyond that nearness to obstacles costs [m]."""
    cost_scaling_factor: float = 4.0
    """Rate at which that cost decays with the distance [1/m]."""
    goal_tolerance: float = 1.6
    """Distance at which a goal counts as reached, in radii of the robot and at most 0.2 m."""
    marking_range: float = 2.5
    """Obstacles seen this near are marked in plans where the map misses them [m] (Nav2's `obstacle_max_range`): legs of
    chairs are too thin to last in a map."""
    stall_time: float = 3.0
    """Time without moving or turning after which the robot tries to free itself [s]."""
    max_recoveries: int = 3
    """Attempts to free itself after which the robot gives the goal up."""
    stuck_distance: float = 0.5
    """A robot that stays within this distance... [m]."""
    stuck_time: float = 30.0
    """...for this long gives the goal up [s] (seed 3, section 3.4.3)."""


class Status(enum.Enum):
    """Where the robot stands with its goal."""

    IDLE = enum.auto()
    """There is none."""
    DRIVING = enum.auto()
    """It is on its way."""
    REACHED = enum.auto()
    """It is there."""
    FAILED = enum.auto()
    """It has given up."""


class Navigator:
    """Drives a robot to one goal at a time."""

    def __init__(
        self,
        robot: RobotParams,
        control_period: float,
        rng: np.random.Generator,
        params: NavigatorParams = NavigatorParams(),
    ) -> None:
        """Prepare for an episode.

        Args:
            robot: the robot.
            control_period: time between two calls of `act` [s].
            rng: decides which way to turn when nothing else does.
            params: how to drive.
        """
        self._robot = robot
        self._period = control_period
        self._params = params
        radii = [robot.radius + params.padding, *(share * robot.radius for share in params.tight_radii)]
        self._costmap_params = [
            CostmapParams(radius, radius + params.inflation, params.cost_scaling_factor) for radius in radii
        ]
        self.tightness = 0
        """How small the robot is in the plans of its goal; see `survey`."""
        self._goal_tolerance = min(params.goal_tolerance * robot.radius, 0.2)
        self._memory = ObstacleMemory(robot, control_period)
        self._obstacles = NO_POINTS
        self._num_seen = 0
        self._standing = NO_POINTS
        self._follower = PathFollower(robot, control_period)
        self._maneuvers = Maneuvers(robot, control_period, rng)
        self._view: tuple[float, float] | None = None
        self.goal: tuple[float, float] | None = None
        """Where the robot is going (x, y), map frame [m]."""
        self.status = Status.IDLE
        """Where it stands with that."""
        self._start_over()

    def _start_over(self) -> None:
        """Forget how the way to a goal has gone so far."""
        self._recoveries = 0
        self._stall = Dwell(0.25 * self._robot.radius + 0.02, 0.3)
        self._stuck = Dwell(self._params.stuck_distance)

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return self._follower.remaining if self.status is Status.DRIVING else None

    @property
    def max_tightness(self) -> int:
        """How many times plans can be made with a smaller robot than the last time."""
        return len(self._costmap_params) - 1

    def survey(self, belief: Belief, tightness: int = 0) -> Survey:
        """Look at the map with this robot's footprint.

        Args:
            belief: what the robot believes.
            tightness: 0 for the padded footprint, up to `max_tightness` for the smallest.
        """
        params = self._costmap_params[tightness]
        seen, standing = (
            points[(points**2).sum(axis=1) < self._params.marking_range**2]
            for points in (self._obstacles[: self._num_seen], self._standing)
        )
        return Survey(belief, params, seen, standing)

    @property
    def is_busy(self) -> bool:
        """Whether it is freeing itself or looking around, and no goal can change that."""
        return bool(self._maneuvers)

    def look_around(self) -> None:
        """Turn once around on the spot."""
        self._maneuvers.spin(2.0 * math.pi)

    def drive_to(
        self,
        goal: tuple[float, float],
        path: np.ndarray,
        *,
        view: tuple[float, float] | None = None,
        tightness: int = 0,
        is_change: bool = False,
    ) -> None:
        """Take a new goal.

        Args:
            goal: where to go (x, y), map frame [m].
            path: the way there: shape (n, 2), n > 0, map frame [m].
            view: what to have in the lidar's view in the end (x, y), map frame [m].
            tightness: of the survey that the way was found in.
            is_change: whether the robot only changes its mind on the way to another goal. The time for which it has got
                nowhere then goes on: goals that change faster than that is noticed would keep it there for ever.
        """
        if not is_change:
            self._start_over()
        self._maneuvers.clear()
        self.goal = goal
        self.status = Status.DRIVING
        self._view = view
        self.tightness = tightness
        self._follower.set_path(path)

    def follow(self, path: np.ndarray) -> None:
        """Take another way to the same goal: shape (n, 2), n > 0, map frame [m]; it may end beside the goal."""
        assert self.goal is not None
        self.goal = (float(path[-1, 0]), float(path[-1, 1]))
        self._follower.set_path(path)

    def replan(self, survey: Survey) -> bool:
        """Plan the way to the goal anew; False if there is none any more."""
        assert self.goal is not None
        path = plan_path(survey.costmap, survey.pose[:2], self.goal, tolerance=self._goal_tolerance)
        if path is None:
            return False
        self._follower.set_path(path)
        return True

    def sense(
        self, observation: dict[str, np.ndarray], standing: np.ndarray = NO_POINTS, passing: np.ndarray = NO_POINTS
    ) -> None:
        """Take in the obstacles of an observation; to be called once with each, before the others are asked.

        Args:
            observation: with `scan` and `motion`.
            standing: shape (n, 2), obstacles that come and go, and that plans lead around, base frame [m].
            passing: shape (n, 2), the same of those that plans need not lead around, because they will be gone [m].
        """
        seen = self._memory.update(observation["scan"], observation["motion"])
        self._num_seen, self._standing = len(seen), standing
        self._obstacles = np.concatenate([seen, standing, passing]) if len(standing) + len(passing) else seen

    def wait(self) -> None:
        """Give up the goal and whatever else was to be done, and stand still."""
        self._maneuvers.clear()
        self.goal, self.status = None, Status.IDLE

    def act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action, shape (2,), float32, that brings the robot nearer to its goal; updates `status`."""
        robot, pose = self._robot, belief.pose
        motion, obstacles = observation["motion"], self._obstacles
        if motion[4] > 0.5 and not self._maneuvers:
            self._recover(obstacles, backwards=motion[2] >= 0.0)
        if self._maneuvers:
            return self._action(self._maneuvers.next(obstacles))
        if self.status is not Status.DRIVING:
            return self._action(Twist(0.0, 0.0))
        assert self.goal is not None
        if math.hypot(pose.x - self.goal[0], pose.y - self.goal[1]) <= self._goal_tolerance:
            turn = self._turn_to_view(pose)
            if turn == 0.0:
                self.status = Status.REACHED
            return self._action(self._follower.rotate(turn))
        if self._stuck.update(pose) * self._period > self._params.stuck_time:
            self.status = Status.FAILED
            return self._action(Twist(0.0, 0.0))
        if self._stall.update(pose) * self._period > self._params.stall_time:
            self._recover(obstacles, backwards=True)
            return self._action(self._maneuvers.next(obstacles))
        twist = Twist(float(motion[0]) * robot.max_v, float(motion[1]) * robot.max_w)
        return self._action(self._follower.command(pose, twist, obstacles))

    def _action(self, twist: Twist) -> np.ndarray:
        action = np.array([twist.v / self._robot.max_v, twist.w / self._robot.max_w], dtype=np.float32)
        return np.clip(action, -1.0, 1.0)

    def _turn_to_view(self, pose: Pose2D) -> float:
        """Return by how much to turn to get what the goal is to show well into the lidar's view [rad]; 0 if it is."""
        lidar = self._robot.lidar
        if self._view is None or lidar.fov > 2.0 * math.pi - 0.1:
            return 0.0
        away = pose.between(Pose2D(*self._view, 0.0))
        bearing = wrap_angle(math.atan2(away.y, away.x) - lidar.mount.yaw)
        return bearing if abs(bearing) > 0.4 * lidar.fov and math.hypot(away.x, away.y) > 0.05 else 0.0

    def _recover(self, obstacles: np.ndarray, *, backwards: bool) -> None:
        """Get free; after too many attempts the goal has failed."""
        self._recoveries += 1
        if self._recoveries > self._params.max_recoveries and self.status is Status.DRIVING:
            self.status = Status.FAILED
        self._maneuvers.back_off(obstacles, backwards=backwards)
        self._stall.restart()
