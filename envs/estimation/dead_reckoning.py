from typing import Any

import numpy as np

from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.simulation import Reading

from .belief import Belief, Estimator


class DeadReckoning(Estimator):
    """Pose estimation by odometry alone; scans are ignored."""

    uses_first_scan = False
    follows_odometry = True

    def reset(
        self, rng: np.random.Generator, pose: Pose2D | None = ORIGIN, map: Any = None, covariance: Any = None
    ) -> Belief:
        if pose is None:
            raise ValueError("dead reckoning needs a start pose; use localizer='amcl'")
        return super().reset(rng, pose, map)

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        self.belief.pose = self.belief.pose.compose(motion)
        return self.belief
