"""Navigation: reach a goal on a known map."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np

from envs.arguments import check_positive, is_pose
from envs.geometry import OccupancyGrid, Pose2D
from envs.geometry.pose import distance
from envs.measures import Course, Measure, final, when_successful
from envs.observations import Goal, PoseUncertainty
from envs.robot import Prior, Robot
from envs.robots import RobotParams
from envs.simulation import Simulator
from envs.task import ObservationPart

from .goals import GeodesicDistance, draw_goal, known_map
from .rewards import NavigateRewards
from .starts import WorldTask

INITIAL_STD, INITIAL_STD_THETA = 0.1, math.radians(5.0)
"""Standard deviations of the initial pose that a localizer is given, per axis [m] and of the heading [rad]."""


def path_efficiency(course: Course) -> float:
    """Return success weighted by path length: 0 without success, else shortest length over the length driven.

    Anderson et al., "On Evaluation of Embodied Navigation Agents" (2018), section 3.2.
    """
    shortest = float(course.samples["way_to_goal"][0])
    return float(course.final["is_success"]) * shortest / max(final(course, "path_length"), shortest, 1e-9)


class Navigate(WorldTask):
    """Drive to a goal on a known map. Ends with "reached" when the true pose is at the goal."""

    measures = (
        Measure("spl", "success by path length", "%", True, path_efficiency, 1, 100.0, is_headline=True),
        Measure("time_to_goal", "time to the goal", "s", False, when_successful, limit="time_limit"),
        Measure("way_left", "distance left", "m", False, partial(final, name="way_to_goal"), 2),
    )
    progress = "progress"

    reset_options = ("goal",)

    def __init__(
        self,
        robot: RobotParams,
        *,
        goal: Any,
        goal_tolerance: float,
        heading_tolerance: float,
        initial_pose: Literal["known", "unknown"],
        is_exact: bool,
        map: OccupancyGrid | None,
        map_pose: tuple[float, float, float],
        reward: NavigateRewards | Mapping[str, float],
        **worlds: Any,
    ) -> None:
        """See `NavigateEnv` for the arguments; `worlds` are those of `WorldTask`.

        Raises:
            ValueError: if one is not allowed; the message names it and what is.
        """
        if initial_pose not in ("known", "unknown"):
            raise ValueError(f"initial_pose must be 'known' or 'unknown', got {initial_pose!r}")
        check_positive(goal_tolerance=goal_tolerance)
        if not 0 < heading_tolerance <= math.pi:
            raise ValueError(f"heading_tolerance must lie in (0, pi], got {heading_tolerance!r}")
        if not (is_pose(goal) or (isinstance(goal, str) and goal == "random")):
            raise ValueError(f"goal must be 'random' or (x, y, theta), got {goal!r}")
        if not is_pose(map_pose):
            raise ValueError(f"map_pose must be (x, y, theta), got {map_pose!r}")
        self.weights = NavigateRewards.of(reward)
        self.map_pose = Pose2D(*(float(k) for k in map_pose))
        self._map = map
        self._goal = goal
        self._tolerances = goal_tolerance, heading_tolerance
        self._initial_pose = initial_pose
        self._is_exact = is_exact  # dead reckoning could not make up for a wrong start
        super().__init__(robot, **worlds)

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the goal, and the pose's uncertainty as "doubt"; see `Task`."""
        return {"goal": lambda: Goal(self.current_goal), "doubt": PoseUncertainty}

    def current_goal(self) -> Pose2D:
        """Return where to go, map frame."""
        return self.goal

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        """Return what the localizer may know of the start, and the map; see `Task`."""
        grid = known_map(self.area) if self._map is None else self._map
        if self._initial_pose == "unknown":
            return Prior(None, grid)
        pose = self.map_pose.between(self.starts[0])
        std = np.array([INITIAL_STD, INITIAL_STD, INITIAL_STD_THETA])
        offset = std * rng.standard_normal(3)
        given = Pose2D(pose.x + offset[0], pose.y + offset[1], pose.theta + offset[2])
        cell = grid.cells(np.array(given[:2]))
        if self._is_exact or not grid.contains(cell) or grid.data[tuple(cell)] != 0:
            given = pose
        return Prior(given, grid, np.diag(std**2))

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode; see `Task`."""
        (self._one,) = robots
        self._true_pose = self.starts[0]
        self.end_reason = None
        goal = options.get("goal", self._goal)
        if isinstance(goal, str) and goal == "random":
            goal = self.map_pose.between(draw_goal(self.area, self._true_pose, rng))
        return self.set_goal(goal)

    def set_goal(self, goal: tuple[float, float, float]) -> float:
        """Set a goal (x, y, theta), map frame, and return how long it usually takes to get there [s].

        Raises:
            ValueError: if the goal is not finite, or no pose that the robot can reach.
        """
        if not is_pose(goal):
            raise ValueError(f"goal must be (x, y, theta), all finite, got {goal!r}")
        self.goal = Pose2D(*(float(k) for k in goal))
        """Where to go, map frame."""
        self._true_goal = self.map_pose.compose(self.goal)
        self._geodesic = GeodesicDistance(self.area, self._true_goal)
        self._path_left = self._path_length = self._geodesic.length(self._true_pose)
        self.end_reason = None
        # Four times what the path takes at full speed, and as long again to find out where the robot is.
        usual = 30.0 + 4.0 * self._path_left / self._robot.max_v + 60.0 * (self._initial_pose == "unknown")
        return 10.0 * round(0.1 * usual)

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Measure how far the robot came; see `Task`."""
        self._true_pose = simulator.states[0].pose
        before, self._path_left = self._path_left, self._geodesic.length(self._true_pose)
        self._gained, self._period = before - self._path_left, period
        self._touching = robots[0].reading.bumper
        self.end_reason = "reached" if self._is_at_goal() else None

    def quantities(self) -> dict[str, float]:
        """Return progress [m], time [s], time in contact [s], and whether the goal is reached."""
        return {
            "progress": self._gained,
            "time": self._period,
            "collision": self._period * self._touching,
            "reached": float(self.end_reason is not None),
        }

    def metrics(self) -> dict[str, Any]:
        """Return how far it is to the goal; see `Task`."""
        pose, goal = self._true_pose, self._true_goal
        return {
            "distance_to_goal": distance(pose.x - goal.x, pose.y - goal.y),
            "way_to_goal": self._path_left,
            "progress": 1.0 if self._is_at_goal() else max(0.0, 1.0 - self._path_left / max(self._path_length, 1e-9)),
            "is_lost": self._one.belief.is_lost,
            "is_success": self._is_at_goal(),
        }

    def _is_at_goal(self) -> bool:
        to_goal = self._true_pose.between(self._true_goal)
        near, aligned = self._tolerances
        return distance(to_goal.x, to_goal.y) <= near and abs(to_goal.theta) <= aligned
