from typing import Any

import numpy as np

from lidarnaut.envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.simulation import Reading

from .belief import ORIGIN, Belief


class DeadReckoning:
    """Pose estimation by odometry alone; scans are ignored."""

    uses_first_scan = False
    belief: Belief

    def reset(
        self, rng: np.random.Generator, pose: Pose2D | None = ORIGIN, map: Any = None, covariance: Any = None
    ) -> Belief:
        """Start at `pose` in the map frame. Without a map, use a map of one unknown cell.

        Raises:
            ValueError: `pose` is None.
        """
        if pose is None:
            raise ValueError("dead reckoning needs a start pose; use localizer='amcl'")
        if map is None:
            blank = OccupancyGrid(np.full((1, 1), UNKNOWN, dtype=np.int8), 0.05, (0.0, 0.0))
            self.belief = Belief(pose, blank)
        else:
            self.belief = Belief(pose, map)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        self.belief.pose = self.belief.pose.compose(motion)
        return self.belief
