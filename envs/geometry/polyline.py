"""Polylines as arrays of points."""

import math

import numpy as np


def lengths_along(points: np.ndarray) -> np.ndarray:
    """Return the lengths from the start of a polyline, shape (n, 2), n > 0, to its points: shape (n,), float64 [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def points_at(points: np.ndarray, along: np.ndarray, distances: np.ndarray | float) -> np.ndarray:
    """Return points of a polyline at distances along it, shape (...) [m]; its ends beyond: shape (..., 2), float64 [m].

    `points`: shape (n, 2), n > 0 [m]; `along`: what `lengths_along` returns for them.
    """
    return np.stack([np.interp(distances, along, points[:, k]) for k in (0, 1)], axis=-1)


def resample(points: np.ndarray, spacing: float) -> np.ndarray:
    """Put points at equal distances of at most `spacing` [m] on a polyline: shape (m, 2), float64 [m].

    Both ends of `points`, shape (n, 2) [m], are among them; fewer than two are returned as they are.
    """
    if len(points) < 2:
        return points
    along = lengths_along(points)
    num_points = max(2, math.ceil(along[-1] / spacing) + 1)
    return points_at(points, along, np.linspace(0.0, along[-1], num_points))
