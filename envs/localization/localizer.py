"""What every localiser offers, and what it answers."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D


@dataclass(slots=True)
class PoseEstimate:
    """Where a localiser takes the robot to be, in the frame of the map.

    Between two corrections by a scan, poses move along with odometry; all else stays as the last correction left it.
    """

    pose: Pose2D
    """The answer: pose of the robot's base. For a cloud of particles the mean of its heaviest cluster."""
    covariance: np.ndarray
    """Shape (3, 3), float64: covariance of x, y, heading around `pose`, map frame [m, m, rad]."""
    weight: float
    """Share of all weight that stands behind `pose`, from 0 to 1: that of the cluster."""
    mean: Pose2D
    """Weighted mean of the whole cloud. Between two hypotheses it lies where neither is."""
    mean_covariance: np.ndarray
    """Shape (3, 3), float64: covariance of the whole cloud around `mean`."""
    fit: float
    """Share of the hits of recent scans that lie near an obstacle of the map if seen from `pose`; NaN while
    no hypothesis has won, and before the first scan with enough hits."""
    is_lost: bool
    """Whether `pose` must not be trusted: no hypothesis has won yet, too few scans have confirmed one
    that came from nowhere, or scans and map do not belong together there."""
    is_corrected: bool
    """Whether the last scan was used to correct the estimate; else odometry alone has moved it."""


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
            occupancy: the map; it is not kept alive.
            pose: where the robot is (map frame), about; None for anywhere on the map's free space.
            rng: later noise is drawn from it.
            covariance: shape (3, 3), of `pose` [m, m, rad]; None leaves it to the params.

        Raises:
            ValueError: if the map has no free cell, or `pose` lies outside of it or on a cell that is not free.
        """
        ...

    def update(self, ranges: np.ndarray, motion: Pose2D) -> PoseEstimate:
        """Take in one scan.

        Args:
            ranges: shape (num_beams,), float32 [m], as in `Reading.ranges`: +inf for no return, NaN for a beam to
                ignore.
            motion: pose of the base now, as odometry sees it from the base at the previous scan.

        Raises:
            ValueError: if the scan has another number of beams, or the motion is not finite.
        """
        ...
