"""Localization on a known map as an estimator."""

import numpy as np

from envs.estimation import ORIGIN, Belief
from envs.geometry import OccupancyGrid, Pose2D

from .localizer import Localizer, PoseEstimate


class KnownMapEstimator:
    """An `Estimator` around a `Localizer`: the map stays as it is, the pose estimate is the localizer's."""

    def __init__(self, localizer: Localizer) -> None:
        """Take a localizer."""
        self.localizer = localizer
        self._belief: Belief

    @property
    def belief(self) -> Belief:
        """The pose estimate on the known map."""
        return self._belief

    def reset(
        self,
        rng: np.random.Generator,
        pose: Pose2D | None = ORIGIN,
        map: OccupancyGrid | None = None,
        covariance: np.ndarray | None = None,
    ) -> Belief:
        """Start on a map.

        Args:
            rng: the localizer's noise is drawn from it.
            pose: where the robot is, about, map frame; None for anywhere on the map's free space.
            map: the map.
            covariance: shape (3, 3), of `pose` [m, m, rad].

        Raises:
            ValueError: there is no map, or the localizer cannot start there.
        """
        if map is None:
            raise ValueError("localization needs a map")
        estimate = self.localizer.reset(map, pose, rng, covariance=covariance)
        self._belief = Belief(estimate.pose, map)
        return self._follow(estimate)

    def update(self, ranges: np.ndarray, motion: Pose2D) -> Belief:
        """Process one scan; see `Estimator`."""
        return self._follow(self.localizer.update(ranges, motion))

    def _follow(self, estimate: PoseEstimate) -> Belief:
        belief = self._belief
        belief.pose, belief.covariance, belief.is_lost = estimate.pose, estimate.covariance, estimate.is_lost
        return belief
