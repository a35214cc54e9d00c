"""Exploration after which the robot is to come back to its start."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from envs.observations.home import Home
from envs.robot import Robot
from envs.robots import RobotParams
from envs.simulation import Simulator
from envs.task import ObservationPart

from .explore import Explore
from .rewards import ReturnRewards, RewardWeights

HOME_RADIUS = 0.3
"""Distance between the robot's true position and its start at which it has returned [m]."""


class ExploreAndReturn(Explore):
    """Explore a world with one robot, and drive back. Ends with "returned" once the robot is at its start again.

    The robot is called back when the explored fraction reaches the target, or by `call_back` before.
    """

    weights_kind = ReturnRewards

    def __init__(self, robot: RobotParams, *, reward: RewardWeights | Mapping[str, float], **arguments: Any) -> None:
        """See `Explore`; weights without the term `returned` get its default."""
        if type(reward) is RewardWeights:
            reward = asdict(reward)
        super().__init__(robot, reward=reward, **arguments)
        self.is_returning = False

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return "home", which is not shown otherwise; see `Task`."""
        return {**super().observation_parts(), "home": partial(Home, self._calls_back)}

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode; see `Explore`."""
        self.is_returning = self._is_covered = self._has_completed = False
        self._time_home = 0.0
        return super().reset(simulator, robots, rng, options)

    def call_back(self) -> None:
        """Tell that exploration is over though the target is not reached: the explorer knows of no frontier."""
        self.is_returning = True

    def _calls_back(self) -> bool:
        return self.is_returning

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Count what was explored, and see whether the robot has returned; see `Task`."""
        if self.is_returning:
            self._time_home += period
        super().update(simulator, robots, period)
        is_covered, self.end_reason = self.end_reason is not None, None
        self._has_completed = is_covered and not self._is_covered
        self._is_covered |= is_covered
        self.is_returning |= is_covered
        (x, y, _), (home_x, home_y, _) = simulator.states[0].pose, self.map_pose
        if self.is_returning and math.hypot(x - home_x, y - home_y) <= HOME_RADIUS:
            self.end_reason = "returned"

    def quantities(self) -> dict[str, float]:
        """Return those of `Explore`, and whether the robot has returned."""
        completed, returned = float(self._has_completed), float(self.end_reason == "returned")
        return super().quantities() | {"completed": completed, "returned": returned}

    def metrics(self) -> dict[str, Any]:
        """Return how much is explored, whether the robot has returned, and how long that took; see `Task`."""
        returned = self.end_reason == "returned"
        return super().metrics() | {
            "is_success": self._is_covered and returned,
            "returned": returned,
            "time_home": self._time_home,
        }
