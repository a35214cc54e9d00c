import math

import numpy as np

from lidarnaut.envs.geometry import GrowingArray, Pose2D
from lidarnaut.envs.geometry.lines import points_at

TRAIL_SPACING = 0.1
"""Minimum distance between stored positions of a robot's path [m]."""


def interpolate(positions: np.ndarray) -> np.ndarray:
    """Resample a polyline at a spacing of about `TRAIL_SPACING`: shape (n, 2), float64 [m]. Vertices are kept."""
    counts = np.maximum(np.hypot(*np.diff(positions, axis=0).T) // TRAIL_SPACING, 1.0).astype(np.int64)
    along = np.concatenate([k + np.arange(n) / n for k, n in enumerate(counts.tolist())] + [[float(len(counts))]])
    return points_at(positions, np.arange(len(positions)), along)


class Trail:
    """Path of a robot, stored as positions about `TRAIL_SPACING` apart."""

    def __init__(self) -> None:
        self._positions = GrowingArray((2,), np.float64, 256)
        self.last = (math.inf, math.inf)
        """Last stored position (x, y) [m]; infinite if the trail is empty."""

    def append(self, pose: Pose2D) -> bool:
        """Append a position at least `TRAIL_SPACING` away from the last position. Return True if appended."""
        dx, dy = pose.x - self.last[0], pose.y - self.last[1]
        if dx * dx + dy * dy < TRAIL_SPACING * TRAIL_SPACING:
            return False
        self.last = pose.x, pose.y
        self._positions.append(self.last)
        return True

    def extend(self, positions: np.ndarray) -> None:
        """Append positions, shape (n, 2), float64 [m], without a check of their spacing."""
        for x, y in positions.tolist():
            self.last = x, y
            self._positions.append(self.last)

    def replace(self, positions: np.ndarray) -> None:
        """Replace the stored positions, for example after a loop closure: shape (n, 2), float64 [m]."""
        self._positions, self.last = GrowingArray((2,), np.float64, 256), (math.inf, math.inf)
        for x, y in positions.tolist():
            self.append(Pose2D(x, y, 0.0))

    @property
    def positions(self) -> np.ndarray:
        """View of the stored positions: shape (n, 2), float64 [m]."""
        return self._positions.rows
