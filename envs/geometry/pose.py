"""Poses and rigid transforms in the plane."""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit


@njit(cache=True)
def wrap_angle(theta: float) -> float:
    """Return `theta` [rad] wrapped to [-pi, pi)."""
    return (theta + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def distance(dx: float, dy: float) -> float:
    """Return the length of the vector (dx, dy), with equal rounding in compiled and uncompiled functions."""
    return math.sqrt(dx * dx + dy * dy)


@njit(cache=True)
def compose(x, y, theta, other_x, other_y, other_theta):
    """Transform the pose `other` from the frame of the pose (x, y, theta) to the parent frame."""
    c, s = math.cos(theta), math.sin(theta)
    return x + c * other_x - s * other_y, y + s * other_x + c * other_y, wrap_angle(theta + other_theta)


@njit(cache=True)
def between(x, y, theta, other_x, other_y, other_theta):
    """Transform the pose `other` from the parent frame to the frame of the pose (x, y, theta)."""
    c, s = math.cos(theta), math.sin(theta)
    dx, dy = other_x - x, other_y - y
    return c * dx + s * dy, c * dy - s * dx, wrap_angle(other_theta - theta)


def between_poses(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    """Return `child` poses relative to `parent` poses, shape (n, 3) [m, m, rad]."""
    c, s = np.cos(parent[:, 2]), np.sin(parent[:, 2])
    dx, dy = (child - parent)[:, :2].T
    return np.stack([c * dx + s * dy, -s * dx + c * dy, wrap_angle(child[:, 2] - parent[:, 2])], axis=1)


class Pose2D(NamedTuple):
    """2D pose, or rigid transform from the pose's frame to the parent frame."""

    x: float
    """x position in the parent frame [m]."""
    y: float
    """y position in the parent frame [m]."""
    theta: float
    """Heading in the parent frame, counter-clockwise from x [rad]."""

    def compose(self, other: "Pose2D") -> "Pose2D":
        """Transform the pose `other` from this pose's frame to the parent frame."""
        return Pose2D(*compose(*self, *other))

    def inverse(self) -> "Pose2D":
        """Return the inverse transform, the pose of the parent frame in this pose's frame."""
        return self.between(Pose2D(0.0, 0.0, 0.0))

    def between(self, other: "Pose2D") -> "Pose2D":
        """Transform the pose `other` from the parent frame to this pose's frame."""
        return Pose2D(*between(*self, *other))

    def transform(self, points: np.ndarray) -> np.ndarray:
        """Transform points, shape (n, 2) [m], from this pose's frame to the parent frame: shape (n, 2), float64 [m]."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + (self.x, self.y)


ORIGIN = Pose2D(0.0, 0.0, 0.0)
