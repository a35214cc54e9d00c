"""Following a route by a pose that is fused from map, encoders and compass."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from envs.arguments import check_positive
from envs.estimation import ORIGIN
from envs.estimation.motion import MotionSource
from envs.geometry import OccupancyGrid, Pose2D
from envs.geometry.pose import distance
from envs.localization.fusion import FusedPose, start_covariance
from envs.measures import Measure, final, root_mean_square, when_successful
from envs.observations import RouteAhead
from envs.robot import Robot
from envs.robots import RobotParams
from envs.simulation import Reading, RobotState, Twist
from envs.task import ObservationPart, Task
from envs.worlds import World, load_world

from .rewards import TrackRewards
from .route import END, Progress, Route, rectangle
from .route_map import make_route_map


class FusedRobot(Robot):
    """A robot whose estimate is a `FusedPose`: localizer, encoders and compass in a Kalman filter."""

    def __init__(self, params: RobotParams, control_period: float, fused: FusedPose, odometry: MotionSource) -> None:
        """Take the filter in place of an estimator; see `Robot`."""
        super().__init__(params, control_period, fused, odometry)  # type: ignore[arg-type]
        self._fused = fused

    def start_on(self, grid: OccupancyGrid, north: float, reading: Reading, rng: np.random.Generator, std: Any) -> None:
        """Begin an episode at the origin of a map; see `FusedPose.reset`.

        `std` are the standard deviations of the start's position [m] and heading [rad].
        """
        self.estimate = self._fused.reset(grid, north, ORIGIN, reading, rng, start_covariance(*std))
        self.start(reading)

    def locate(self) -> None:
        """Process the last reading: its scan, encoders and compass."""
        self.estimate = self._fused.update(self.reading)
        self.twist = Twist(self.estimate.v, self.estimate.w)
        pose = self.estimate.pose
        if self.trail.append(pose):
            self.pyramid.mark(pose.x, pose.y)


class FollowRoute(Task):
    """Follow a route to its end. Ends with "completed", or with "strayed" too far from the route."""

    measures = (
        Measure("progress", "route driven", "%", True, partial(final, name="progress"), 1, 100.0),
        Measure(
            "deviation_rmse",
            "deviation from the route",
            "cm",
            False,
            partial(root_mean_square, name="deviation"),
            1,
            100.0,
            is_headline=True,
        ),
        Measure("time_to_end", "time to the end", "s", False, when_successful, limit="time_limit"),
    )
    progress = "progress"

    def __init__(
        self,
        robot: RobotParams,
        *,
        world: str | World,
        path: Any,
        max_deviation: float,
        start_spread: tuple[float, float],
        reward: TrackRewards | Mapping[str, float],
        **mapping: Any,
    ) -> None:
        """See `TrackEnv` for the arguments; `mapping` are those of `make_route_map`.

        Raises:
            ValueError: if one is not allowed; the message names it and what is.
        """
        check_positive(max_deviation=max_deviation)
        if len(start_spread) != 2 or not all(0 <= spread < math.inf for spread in start_spread):
            raise ValueError(f"start_spread must be two numbers that are not negative, got {start_spread!r}")
        self.weights = TrackRewards.of(reward)
        self.world = world if isinstance(world, World) else load_world(world)
        self.route_world = Route.of(rectangle(self.world.spawns[0]) if path is None else path)
        self.map_pose = self.route_world.start
        self.route = self.route_world.seen_from(self.map_pose)
        """The route in the map frame."""
        self._robot = robot
        self._max_deviation = max_deviation
        self._start_spread = start_spread
        self._make_map = partial(make_route_map, robot=robot, path=self.route_world.points.tobytes(), **mapping)

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the route; see `Task`."""
        return {"route": partial(RouteAhead, self.points_ahead)}

    def points_ahead(self, distances: np.ndarray) -> np.ndarray:
        """Return the points of the route at distances ahead of the estimated pose [m]: shape (n, 2), map frame [m]."""
        return self.route_progress.ahead(distances)

    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        """Return the world of the route.

        Raises:
            ValueError: another one is asked for.
        """
        if world is not None:
            raise ValueError("the world of a route cannot change at a reset; make another environment")
        return self.world

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> list[Pose2D]:
        """Return where the robot starts, near the beginning of the route.

        Raises:
            ValueError: another start is asked for.
        """
        if start is not None:
            raise ValueError("a route has its own start; make another environment")
        spread, turn = self._start_spread
        offset = Pose2D(*(rng.standard_normal(3) * (spread, spread, turn)).tolist())
        self._start = self.map_pose.compose(offset)
        return [self._start]

    def reset(
        self,
        robots: Sequence[Robot],
        readings: Sequence[Reading],
        rngs: Sequence[np.random.Generator],
        rng: np.random.Generator,
        options: Mapping[str, Any],
    ) -> float:
        """Start an episode; the first one makes the map. See `Task`."""
        (robot,) = robots
        assert isinstance(robot, FusedRobot)
        route_map = self._make_map(self.world)
        robot.start_on(route_map.grid, route_map.north, readings[0], rngs[0], self._start_spread)
        self._one = robot
        self.end_reason = None
        self.route_progress, self._true_progress = Progress(self.route), Progress(self.route_world)
        self._follow(self._start, robot)
        # Twice the time that the route takes at full speed, and half a minute.
        return 30.0 + 2.0 * self.route.length / self._robot.max_v

    def update(self, states: Sequence[RobotState], robots: Sequence[Robot], period: float) -> None:
        """Measure how far the robot came; see `Task`."""
        pose, before = states[0].pose, self._driven
        self._follow(pose, robots[0])
        away = distance(*(self._true_progress.route.points[self._true_progress.index] - pose[:2]))
        self._gained, self._period, self._touching = self._driven - before, period, robots[0].reading.bumper
        if self._driven >= self.route.length - END:
            self.end_reason = "completed"
        elif away > self._max_deviation:
            self.end_reason = "strayed"

    def quantities(self) -> dict[str, float]:
        """Return progress [m], deviation times time [m s], time [s], time in contact [s], and whether it is over."""
        return {
            "progress": self._gained,
            "deviation": self._period * abs(self._deviation),
            "time": self._period,
            "collision": self._period * self._touching,
            "completed": float(self.end_reason == "completed"),
        }

    def metrics(self) -> dict[str, Any]:
        """Return how far the robot came; see `Task`."""
        return {
            "progress": self._driven / self.route.length,
            "deviation": self._deviation,
            "is_lost": self._one.belief.is_lost,
            "is_success": self._driven >= self.route.length - END,
        }

    def _follow(self, true_pose: Pose2D, robot: Robot) -> None:
        self._driven, self._deviation = self._true_progress.update(true_pose)
        self.route_progress.update(robot.belief.pose)
