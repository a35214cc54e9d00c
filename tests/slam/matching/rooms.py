"""Scans of simple shapes, for tests of matching."""

import numpy as np

from envs.slam.matching.submap_field import Scans


def cast(segments, pose, angles, max_range):
    """Return the ranges of beams up to wall segments, shape (n,), inf where there is none [m].

    Args:
        segments: shape (k, 4), x0, y0, x1, y1 [m].
        pose: x, y, heading of the lidar [m, m, rad].
        angles: of the beams, shape (n,) [rad].
        max_range: farthest return [m].
    """
    heading = np.asarray(angles)[:, None] + pose[2]
    dx, dy = np.cos(heading), np.sin(heading)
    ox, oy = segments[:, 0] - pose[0], segments[:, 1] - pose[1]
    ax, ay = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        det = ax * dy - ay * dx
        t = (ax * oy - ay * ox) / det
        u = (dx * oy - dy * ox) / det
        hit = (t > 0.0) & (t < max_range) & (u >= 0.0) & (u <= 1.0)
    return np.where(hit, t, np.inf).min(axis=1)


def visible_points(segments, pose, angles, max_range, rng=None):
    """Return the hits of beams in the frame of the pose, shape (n, 2), float32 [m].

    If `rng` is given, ranges have noise of 1 cm. For the other arguments see `cast`.
    """
    ranges = cast(segments, pose, angles, max_range)
    if rng is not None:
        ranges += 0.01 * rng.standard_normal(len(ranges))
    hit = np.isfinite(ranges)
    directions = np.stack([np.cos(angles[hit]), np.sin(angles[hit])], axis=1)
    return (ranges[hit, None] * directions).astype(np.float32)


def rectangle(x0, y0, x1, y1):
    """Return the four walls of a rectangle, shape (4, 4)."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]], dtype=float)


ROOM = np.concatenate([rectangle(0.0, 0.0, 6.0, 4.0), rectangle(4.0, 1.0, 4.6, 1.5), [[2.0, 4.0, 2.0, 2.8]]])
"""A room of 6 m x 4 m with a box and a partition, shape (9, 4) [m]."""


def take_scans(segments, poses, num_beams=180, max_range=10.0, seed=0):
    """Return `Scans` of wall segments from poses, shape (n, 3)."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(-np.pi, np.pi, num_beams, endpoint=False)
    points = [visible_points(segments, pose, angles, max_range, rng) for pose in poses]
    ends = np.cumsum([len(each) for each in points])
    spans = np.stack([ends - [len(each) for each in points], ends], axis=1)
    return Scans(np.concatenate(points), spans, np.array(poses, dtype=float), 0.0, 0.0)
