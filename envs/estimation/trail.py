import math

import numpy as np

from lidarnaut.envs.geometry import Pose2D

TRAIL_SPACING = 0.1
"""Minimum distance between stored positions of a robot's path [m]."""


def interpolate(positions: np.ndarray) -> np.ndarray:
    """Resample a polyline at a spacing of about `TRAIL_SPACING`: shape (n, 2), float64 [m]. Vertices are kept."""
    lengths = np.hypot(*np.diff(positions, axis=0).T)
    counts = np.maximum(lengths // TRAIL_SPACING, 1.0).astype(np.int64)
    along = np.concatenate([k + np.arange(n) / n for k, n in enumerate(counts.tolist())] + [[float(len(counts))]])
    numbers = np.arange(len(positions))
    return np.column_stack([np.interp(along, numbers, positions[:, axis]) for axis in (0, 1)])


class Trail:
    """Path of a robot, stored as positions about `TRAIL_SPACING` apart."""

    def __init__(self) -> None:
        self._buffer = np.empty((256, 2))
        self._length = 0
        self.last = (math.inf, math.inf)
        """Last stored position (x, y) [m]; infinite if the trail is empty."""

    def append(self, pose: Pose2D) -> bool:
        """Append a position at least `TRAIL_SPACING` away from the last position. Return True if appended."""
        dx, dy = pose.x - self.last[0], pose.y - self.last[1]
        if dx * dx + dy * dy < TRAIL_SPACING * TRAIL_SPACING:
            return False
        if self._length == len(self._buffer):
            self._buffer = np.concatenate([self._buffer, np.empty_like(self._buffer)])
        self._buffer[self._length] = self.last = pose.x, pose.y
        self._length += 1
        return True

    def extend(self, positions: np.ndarray) -> None:
        """Append positions, shape (n, 2), float64 [m], without a check of their spacing."""
        count = self._length + len(positions)
        while count > len(self._buffer):
            self._buffer = np.concatenate([self._buffer, np.empty_like(self._buffer)])
        self._buffer[self._length : count] = positions
        self._length = count
        if len(positions):
            self.last = (float(positions[-1, 0]), float(positions[-1, 1]))

    def replace(self, positions: np.ndarray) -> None:
        """Replace the stored positions, for example after a loop closure: shape (n, 2), float64 [m]."""
        self._length = 0
        self.last = (math.inf, math.inf)
        for x, y in positions.tolist():
            self.append(Pose2D(x, y, 0.0))

    @property
    def positions(self) -> np.ndarray:
        """View of the stored positions: shape (n, 2), float64 [m]."""
        return self._buffer[: self._length]
