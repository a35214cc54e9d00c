"""Following a route by a pose that is fused from map, encoders and compass."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from envs.arguments import check_positive
from envs.estimation import ORIGIN
from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.localization.fusion import FusedPose, start_covariance
from envs.measures import Measure, final, root_mean_square, when_successful
from envs.observations import RouteAhead
from envs.robot import Prior, Robot
from envs.robots import RobotParams
from envs.simulation import Simulator
from envs.task import ObservationPart, Task
from envs.worlds import World, load_world

from .rewards import TrackRewards
from .route import END, Progress, Route, rectangle
from .route_map import make_route_map


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
        fused: FusedPose,
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
        self._robot, self._fused = robot, fused
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
        self.starts = [self.map_pose.compose(offset)]
        return self.starts

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        """Return the map, which the first episode makes, and its origin as the start; see `Task`."""
        route_map = self._make_map(self.world)
        self._fused.north = route_map.north
        return Prior(ORIGIN, route_map.grid, start_covariance(*self._start_spread)[:3, :3])

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode; see `Task`."""
        (self._one,) = robots
        self.end_reason = None
        self.route_progress, self._true_progress = Progress(self.route), Progress(self.route_world)
        self._follow(self.starts[0], self._one)
        # Twice the time that the route takes at full speed, and half a minute.
        return 30.0 + 2.0 * self.route.length / self._robot.max_v

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Measure how far the robot came; see `Task`."""
        pose, before = simulator.states[0].pose, self._driven
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
