"""Rigid motions of the plane."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit


@njit(cache=True)
def wrap_angle(theta: float) -> float:
    """Return the angle equal to `theta` [rad] in the half-open interval [-pi, pi)."""
    return (theta + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def distance(dx: float, dy: float) -> float:
    """Return the length of (dx, dy). The standard library's `hypot` rounds otherwise than the compiled one."""
    return math.sqrt(dx * dx + dy * dy)


@njit(cache=True)
def compose(x, y, theta, other_x, other_y, other_theta):
    """Return, as (x, y, theta), a pose given in the frame of the pose (x, y, theta) in that one's parent frame."""
    c, s = math.cos(theta), math.sin(theta)
    return x + c * other_x - s * other_y, y + s * other_x + c * other_y, wrap_angle(theta + other_theta)


@njit(cache=True)
def between(x, y, theta, other_x, other_y, other_theta):
    """Return, as (x, y, theta), the other pose as seen from the pose (x, y, theta) in the same parent frame."""
    c, s = math.cos(theta), math.sin(theta)
    dx, dy = other_x - x, other_y - y
    return c * dx + s * dy, c * dy - s * dx, wrap_angle(other_theta - theta)


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
        return Pose2D(*compose(*self, *other))

    def inverse(self) -> "Pose2D":
        """Return the parent frame as seen from this pose."""
        return self.between(Pose2D(0.0, 0.0, 0.0))

    def between(self, other: "Pose2D") -> "Pose2D":
        """Return `other`, given in the same parent frame, as seen from this pose."""
        return Pose2D(*between(*self, *other))

    def transform(self, points: np.ndarray) -> np.ndarray:
        """Return points, shape (n, 2) [m], of this pose's frame in the parent frame: shape (n, 2), float64 [m]."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + (self.x, self.y)
