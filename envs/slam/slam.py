"""What every SLAM offers, and what it believes."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D

NO_CELLS = np.empty((0, 2), dtype=np.int32)
"""`new_cells` of a scan that made nothing known."""


@dataclass(slots=True)
class Belief:
    """What the robot thinks of the place and of itself, in the map frame: the robot's pose at the reset is its origin.

    The same object is updated in place by every scan; copy what must outlive the next one.
    """

    pose: Pose2D
    """Estimated pose of the robot's base."""
    grid: OccupancyGrid
    """The map. The array behind it is live, and is replaced when the map grows."""
    new_cells: np.ndarray
    """Shape (k, 2), int32, (row, column) in `grid`: cells that the last scan turned from unknown to known."""
    touched: tuple[int, int, int, int] | None = None
    """First column, first row, last column and last row of what the last scan may have changed in `grid`; None if it
    was not drawn."""
    drawn_at: Pose2D | None = None
    """Pose at which the last scan was drawn that was; None before the first."""


class Slam(Protocol):
    """Simultaneous localisation and mapping. Constructed with the lidar's geometry and the algorithm's params."""

    @property
    def belief(self) -> Belief:
        """The current belief."""
        ...

    def reset(self, rng: np.random.Generator) -> Belief:
        """Forget everything: an unknown map with the robot at its origin. Later noise is drawn from `rng`."""
        ...

    def update(self, ranges: np.ndarray, motion: Pose2D) -> Belief:
        """Take in one scan.

        Args:
            ranges: shape (num_beams,), float32 [m], as in `Reading.ranges`.
            motion: pose of the base now, as odometry sees it from the base at the previous scan.
        """
        ...
