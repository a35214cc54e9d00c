"""Rigid motions of the plane."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit


@njit(cache=True)
def wrap_angle(theta: float) -> float:
    """Return the angle equal to `theta` [rad] in the half-open interval [-pi, pi)."""
    return (theta + math.pi) % (2.0 * math.pi) - math.pi


class Pose2D(NamedTuple):
    """A pose in the plane, or the rigid motion that carries the parent frame onto it."""

    x: float
    """Position along the parent frame's x axis [m]."""
    y: float
    """Position along the parent frame's y axis [m]."""
    theta: float
    """Heading, counter-clockwise from the parent frame's x axis [rad]."""

    def compose(self, other: "Pose2D") -> "Pose2D":
        """Return `other`, given in this pose's frame, in the parent frame (heading wrapped to [-pi, pi))."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2D(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.theta + other.theta),
        )

    def inverse(self) -> "Pose2D":
        """Return the parent frame as seen from this pose."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2D(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.theta))

    def between(self, other: "Pose2D") -> "Pose2D":
        """Return `other`, given in the same parent frame, as seen from this pose."""
        return self.inverse().compose(other)

    def transform(self, points: np.ndarray) -> np.ndarray:
        """Carry points from this pose's frame into the parent frame.

        Args:
            points: shape (n, 2) [m].

        Returns:
            Shape (n, 2), float64 [m].
        """
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + (self.x, self.y)
