"""What every explorer offers, classic or learned."""

from typing import Protocol, runtime_checkable

import numpy as np

from envs.coverage import ExplorableArea
from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.slam import Belief


class Explorer(Protocol):
    """Decides, from what the robot observes and believes, how to drive. Never sees the truth."""

    @property
    def end_reason(self) -> str | None:
        """Why the explorer has stopped exploring ("no_reachable_frontier", ...); None while it has not."""
        ...

    @property
    def plan(self) -> np.ndarray | None:
        """The planned path for drawing, shape (n, 2), map frame [m]; None without one."""
        ...

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode.

        Args:
            robot: the robot that will be driven.
            control_period: time between two calls of `act` [s].
            rng: source of every random draw of the episode.
        """
        ...

    def act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action, shape (2,), float32: forward speed and yaw rate as fractions of the robot's limits."""
        ...


@runtime_checkable
class Omniscient(Protocol):
    """An explorer that is told the truth: no competitor, but the bound that the others are measured against."""

    def reveal(self, area: ExplorableArea, start: Pose2D, target_coverage: float) -> None:
        """Learn the truth about the place of an episode; called after `Explorer.reset`.

        Args:
            area: what there is to see, and the walls.
            start: pose of the map frame's origin in the world frame.
            target_coverage: share of the area that ends the episode.
        """
        ...
