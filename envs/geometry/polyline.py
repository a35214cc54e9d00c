"""Polylines as arrays of points."""

import math

import numpy as np


def lengths_along(points: np.ndarray) -> np.ndarray:
    """Return the length of a polyline from its start to each of its points.

    Args:
        points: shape (n, 2), n > 0 [m].

    Returns:
        Shape (n,), float64 [m]; the last is the length of the whole.
    """
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def points_at(points: np.ndarray, along: np.ndarray, distances: np.ndarray | float) -> np.ndarray:
    """Return the points of a polyline at some distances along it; its ends beyond them.

    Args:
        points: shape (n, 2), n > 0 [m].
        along: shape (n,), what `lengths_along` returns [m].
        distances: shape (...) [m].

    Returns:
        Shape (..., 2), float64 [m].
    """
    return np.stack([np.interp(distances, along, points[:, k]) for k in (0, 1)], axis=-1)


def resample(points: np.ndarray, spacing: float) -> np.ndarray:
    """Put points at equal distances on a polyline, both of its ends among them.

    Args:
        points: shape (n, 2) [m]; fewer than two are returned as they are.
        spacing: greatest distance between two of them along the polyline [m].

    Returns:
        Shape (m, 2), float64 [m].
    """
    if len(points) < 2:
        return points
    along = lengths_along(points)
    num_points = max(2, math.ceil(along[-1] / spacing) + 1)
    return points_at(points, along, np.linspace(0.0, along[-1], num_points))
