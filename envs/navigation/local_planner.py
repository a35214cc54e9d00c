"""What every local planner offers: twists that follow a path around obstacles."""

from typing import Protocol

import numpy as np

from envs.geometry import Pose2D
from envs.simulation import Twist


class LocalPlanner(Protocol):
    """Follows one path at a time. Constructed with the robot, the control period and the planner's params.

    Obstacles come in the robot's own frame and not out of a map, so that stops do not depend on the pose
    estimate.
    """

    @property
    def blocked(self) -> bool:
        """Whether the last command did not drive on because of obstacles."""
        ...

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""
        ...

    def set_path(self, path: np.ndarray, heading: float | None = None) -> None:
        """Follow another path from now on.

        Args:
            path: shape (n, 2), n > 0, map frame [m], points about a map cell apart.
            heading: goal heading at the path's end, map frame [rad]; None for any.
        """
        ...

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the twist to command for the next period.

        Args:
            pose: estimated pose of the base, map frame.
            twist: velocity now, by odometry.
            obstacles: shape (n, 2), float64, base frame [m].
        """
        ...
