"""Exploration: map an unknown world."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from envs.arguments import is_number
from envs.geometry import Pose2D
from envs.measures import Measure, final, mean_over_limit, when
from envs.observations.peers import Peers
from envs.robot import Robot
from envs.robots import RobotParams
from envs.simulation import Simulator
from envs.task import ObservationPart
from envs.worlds import World

from .coverage import Coverage, map_iou
from .rewards import RewardWeights, Weights
from .starts import WorldTask


class Explore(WorldTask):
    """Explore a world with one robot, or with several that share a map.

    Ends with "covered" once the explored fraction reaches the target.
    """

    measures = (
        Measure("explored_fraction", "explored", "%", True, partial(final, name="explored_fraction"), 1, 100.0),
        *(
            Measure(
                f"time_to_{share}",
                f"time to {share} %",
                "s",
                False,
                partial(when, name="explored_fraction", mark=share / 100),
                0,
                limit="time_limit",
            )
            for share in (90, 95, 99)
        ),
        Measure(
            "distance_to_95",
            "distance to 95 %",
            "m",
            False,
            partial(when, name="explored_fraction", mark=0.95, quantity="path_length"),
            limit="distance_limit",
        ),
        Measure(
            "area_under_curve",
            "area under curve",
            "%",
            True,
            partial(mean_over_limit, name="explored_fraction"),
            1,
            100.0,
            is_headline=True,
        ),
        Measure("map_iou", "map IoU", "%", True, partial(final, name="map_iou"), 1, 100.0),
        Measure("area_left", "unexplored area", "m²", False, partial(final, name="area_left")),
    )
    progress = "explored_fraction"
    weights_kind: type[Weights] = RewardWeights
    """Which reward terms there are."""
    is_returning = False
    """Whether the robot is to come back to its start; see `ExploreAndReturn`."""

    def __init__(
        self, robot: RobotParams, *, target_coverage: float, reward: RewardWeights | Mapping[str, float], **worlds: Any
    ) -> None:
        """See `ExploreEnv` for the arguments; `worlds` are those of `WorldTask`.

        Raises:
            ValueError: if one is not allowed; the message names it and what is.
        """
        if not (is_number(target_coverage) and 0 < target_coverage <= 1):
            raise ValueError(f"target_coverage must lie in (0, 1], got {target_coverage!r}")
        self.weights = self.weights_kind.of(reward)
        self.target_coverage = target_coverage
        super().__init__(robot, **worlds)

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the peers of a team as "mates"; see `Task`."""
        return {} if self._num_robots == 1 else {"mates": partial(Peers, self._num_robots - 1)}

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> list[Pose2D]:
        """Return where the robots start; the map frame is the first one's start. See `Task`."""
        starts = super().choose_starts(world, start, rng)
        self.map_pose = starts[0]
        return starts

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode; see `Task`."""
        self.coverage = Coverage(self.area, self.map_pose, simulator.robot.lidar)
        for robot, pose in zip(robots, self.starts, strict=True):
            self._cover(robot, pose)
        self.end_reason = None
        self._robots = robots
        return self.area.usual_time_limit(self._robot.max_v)

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Count what was explored; see `Task`."""
        self._gained, self._period = 0.0, period
        for robot, state in zip(robots, simulator.states, strict=True):
            self._gained += self._cover(robot, state.pose)
        self._touching = sum(robot.reading.bumper for robot in robots)
        if self.coverage.explored_fraction >= self.target_coverage:
            self.end_reason = "covered"

    def quantities(self) -> dict[str, float]:
        """Return explored area [m2], time [s], time in contact [s] of all robots, and whether the target is reached."""
        return {
            "explored": self._gained,
            "time": self._period,
            "collision": self._period * self._touching,
            "completed": float(self.end_reason == "covered"),
        }

    def metrics(self) -> dict[str, Any]:
        """Return how much is explored; see `Task`."""
        fraction = self.coverage.explored_fraction
        return {
            "explored_fraction": fraction,
            "explored_area": self.coverage.explored_area,
            "is_success": fraction >= self.target_coverage,
        }

    def final_metrics(self) -> dict[str, Any]:
        """Return the agreement of the map with the visible walls, and the area that is not explored [m2]."""
        area = self.coverage.area
        left = area.area - self.coverage.explored_area
        return {"map_iou": map_iou(self._robots[0].belief.grid, area, self.map_pose), "area_left": left}

    def _cover(self, robot: Robot, true_pose: Pose2D) -> float:
        belief = robot.belief
        return self.coverage.update(belief.update, belief.grid.resolution, robot.reading.ranges, true_pose)
