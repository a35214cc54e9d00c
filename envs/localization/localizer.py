"""The interface of localizers, their estimate, and the estimator that they make with a known map."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from envs.estimation import ORIGIN, Belief
from envs.geometry import OccupancyGrid, Pose2D
from envs.simulation import Reading


@dataclass(slots=True)
class PoseEstimate:
    """Estimate of the robot's pose in the frame of the map.

    Between two corrections by a scan, poses follow odometry; all else stays as the last correction left it.
    """

    pose: Pose2D
    """Pose of the robot's base. For a particle filter the mean of the heaviest cluster."""
    covariance: np.ndarray
    """Shape (3, 3), float64: covariance of x, y, heading around `pose`, map frame [m, m, rad]."""
    weight: float
    """Share of the cluster in the weight of all particles, from 0 to 1."""
    mean: Pose2D
    """Weighted mean of all particles. With two hypotheses it lies between them, where the robot is not."""
    mean_covariance: np.ndarray
    """Shape (3, 3), float64: covariance of all particles around `mean` [m, m, rad]."""
    fit: float
    """Share of the hits of recent scans that lie near an obstacle of the map as seen from `pose`; NaN until the filter
    has converged, and before the first scan with enough hits."""
    is_lost: bool
    """Whether `pose` must not be trusted: the filter has not converged, too few scans have confirmed a pose found by
    global localization, or the map does not explain the scans."""
    is_corrected: bool
    """Whether the last scan was used; else the estimate followed odometry alone."""


class Localizer(Protocol):
    """Localisation on a known map. Constructed with the lidar's geometry and the algorithm's params."""

    @property
    def estimate(self) -> PoseEstimate:
        """The current estimate. Replaced, not changed, by the next scan."""
        ...

    def reset(
        self,
        occupancy: OccupancyGrid,
        pose: Pose2D | None,
        rng: np.random.Generator,
        *,
        covariance: np.ndarray | None = None,
    ) -> PoseEstimate:
        """Forget everything, and start on a map.

        Args:
            occupancy: the map; it is copied.
            pose: initial pose of the base (map frame); None for global localization, anywhere in the free space.
            rng: source of all later noise.
            covariance: shape (3, 3), of `pose` [m, m, rad]; None for a default of the params.

        Raises:
            ValueError: if the map has no free cell, `pose` lies outside of it or on a cell that is not free, or
                `covariance` is not a covariance matrix.
        """
        ...

    def update(self, ranges: np.ndarray, motion: Pose2D) -> PoseEstimate:
        """Update by one scan.

        Args:
            ranges: shape (num_beams,), float32 [m]: +inf for no return, NaN for a beam to ignore.
            motion: pose of the base now, as odometry sees it from the base at the previous scan.

        Raises:
            ValueError: if the scan has another number of beams, or the motion is not finite.
            RuntimeError: before the first `reset`.
        """
        ...


class KnownMapEstimator:
    """An `Estimator` around a `Localizer`: the map stays as it is, pose and covariance are the localizer's."""

    uses_first_scan = False

    def __init__(self, localizer: Localizer) -> None:
        """Take a localizer."""
        self.localizer = localizer
        self.belief: Belief

    def reset(
        self,
        rng: np.random.Generator,
        pose: Pose2D | None = ORIGIN,
        map: OccupancyGrid | None = None,
        covariance: np.ndarray | None = None,
    ) -> Belief:
        """Start on a map; see `Localizer`.

        Raises:
            ValueError: there is no map, or the localizer cannot start there.
        """
        if map is None:
            raise ValueError("localization needs a map")
        estimate = self.localizer.reset(map, pose, rng, covariance=covariance)
        self.belief = Belief(estimate.pose, map)
        return self._follow(estimate)

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Process the scan of a reading; see `Estimator`."""
        return self._follow(self.localizer.update(reading.ranges, motion))

    def _follow(self, estimate: PoseEstimate) -> Belief:
        belief = self.belief
        belief.pose, belief.covariance, belief.is_lost = estimate.pose, estimate.covariance, estimate.is_lost
        return belief
